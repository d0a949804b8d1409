"""When it pays to refactorize (§3.2), and what the estimates behind it are worth."""
