"""The program: its verbs and their errors, `hil demo` and `hil sim`, and the server of the screen."""
