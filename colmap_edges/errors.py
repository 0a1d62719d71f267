"""Errors that a user can act on: each names what, where and the remedy in one line."""


class ColmapEdgesError(Exception):
    """Bad input, options or environment; its message is one clear line for the user."""


class ImageError(ColmapEdgesError):
    """An image file is damaged; a run can go on without it."""


class OptionError(ColmapEdgesError, ValueError):
    """An option's value is outside its range."""
