"""The one exception that means "your input is bad": the command line prints it as one `error:` line, exit code 2."""


class InputError(ValueError):
    """The user's input is bad. The message is one line that names the file, the place in it and what was wanted."""
