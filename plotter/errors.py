"""Bad input, as a person meets it: one sentence with the value, the bound and the next step."""


class BadInput(Exception):
    """The drawing, a flag or a settings file cannot be used as given."""
