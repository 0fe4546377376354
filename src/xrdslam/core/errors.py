"""The one tree of errors: a message says what was asked, what was found, what to do."""

__all__ = [
    "ConfigError",
    "DataError",
    "MissingExtraError",
    "PluginError",
    "RunError",
    "UnknownNameError",
    "XrdslamError",
]


class XrdslamError(Exception):
    """Base of every error that a user can cause and mend; the command line prints it in one line, exit status 1."""


class ConfigError(XrdslamError):
    """A setting that makes no sense; the message starts with its dotted name and the value."""


class DataError(XrdslamError):
    """Input that is missing, damaged or contradicts itself; the message names the file."""


class UnknownNameError(XrdslamError):
    """A name that no installed distribution registered; the message lists what is installed and what to install."""


class PluginError(XrdslamError):
    """An installed plugin that cannot be used; the message names its distribution, version and cause."""


class MissingExtraError(XrdslamError):
    """An optional dependency that is not installed; the message names the extra."""


class RunError(XrdslamError):
    """A run that could not go on; what was computed has been saved."""
