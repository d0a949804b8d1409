"""The report on when to refactorize."""
