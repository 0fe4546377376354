"""The error of this package."""

from xrdslam.core.errors import XrdslamError

__all__ = ["EvaluationError"]


class EvaluationError(XrdslamError):
    """A number that these inputs do not define; the message says why, and is the reason beside a null in a report."""
