"""Coverage-guided fuzzing of every decoder with atheris (``make fuzz``; Linux)."""
