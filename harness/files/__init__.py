"""Files that are whole, sealed and written by one: what every kind of result rests on."""
