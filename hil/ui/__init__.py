"""What terminal, screen and report share: options and output of the verbs, elements of a page, blocks of a document."""
