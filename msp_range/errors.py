"""The base of errors that a user can put right."""


class UserError(Exception):
    """What a file, an option or a device has that it should not have; every command prints the text in a line."""
