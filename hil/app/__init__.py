"""What terminal, screen and report share, and the program's entry."""
