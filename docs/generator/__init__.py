"""Tables of the docs, made from profiles and vectors. Part of the repository, not of the package."""
