"""What a browser gets, and how: meshcat's viewer with a script of our own in one file, a server on loopback, pictures."""
