"""QPs from elsewhere and for elsewhere: a file for each foreign format, both ways side by side."""
