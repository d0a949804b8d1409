"""The report on other physics engines."""
