"""What every report is put together from: tables, names, sentences, style."""
