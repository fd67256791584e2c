"""A running bridge, seen from outside: a Unix socket with every record and a status, and who reads it."""
