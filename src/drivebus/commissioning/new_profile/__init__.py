"""Creation of a profile from the facts of a manual: questions, register table, commented file."""
