"""Which topics of a ROS recording are meant: those that are set, else the only ones that can be."""

from collections.abc import Mapping, Sequence
from os.path import commonpath

from xrdslam.core.errors import DataError

__all__ = ["IMAGE_TYPES", "choose", "colour_topic", "depth_topic", "info_topic"]

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
NOT_COLOUR = ("depth", "infra", "/ir", "confidence", "mask", "thermal", "label")


def colour_topic(topics: Mapping[str, str], given: str | None, where: str) -> str:
    """Choose the colour images among topics and their types."""
    images = [t for t, kind in topics.items() if kind in IMAGE_TYPES and not any(w in t.lower() for w in NOT_COLOUR)]
    named = [t for t in images if any(word in t.lower() for word in ("rgb", "color", "colour"))]
    return choose(_uncompressed(named or images), topics, given, "rgb_topic", "colour images", where)


def depth_topic(topics: Mapping[str, str], given: str | None, where: str) -> str | None:
    """Choose the depth images, none where there are none or they are not wanted."""
    if given == "none":
        return None
    images = [t for t, kind in topics.items() if kind in IMAGE_TYPES and "depth" in t.lower() and "color_" not in t]
    aligned = [t for t in images if "aligned" in t.lower() or "registered" in t.lower()]
    if given is None and not images:
        return None
    return choose(_uncompressed(aligned or images), topics, given, "depth_topic", "depth images", where)


def info_topic(topics: Mapping[str, str], given: str | None, images: str, where: str) -> str | None:
    """Choose the CameraInfo whose name has most in common with the images', none where there is none."""
    infos = [topic for topic, kind in topics.items() if kind == INFO_TYPE]
    if given is None and not infos:
        return None
    shared = {topic: len(commonpath(["/" + t.strip("/") for t in (topic, images)])) for topic in infos}
    best = [topic for topic in infos if shared[topic] == max(shared.values())]
    return choose(best, topics, given, "info_topic", "a CameraInfo", where)


def choose(
    candidates: Sequence[str], topics: Mapping[str, str], given: str | None, key: str, what: str, where: str
) -> str:
    """Return the topic that is set, or the only candidate; else say what there is."""
    listing = ", ".join(f"{topic} ({kind.rpartition('/')[2]})" for topic, kind in sorted(topics.items())) or "nothing"
    if given is not None:
        if given not in topics:
            raise DataError(f"dataset.{key}={given}: no such topic in {where}; there is: {listing}")
        return given
    if len(candidates) == 1:
        return candidates[0]
    found = f"{len(candidates)} topics may be {what}: {', '.join(candidates)}" if candidates else f"no topic has {what}"
    raise DataError(f"{where}: {found}; set dataset.{key}. There is: {listing}")


def _uncompressed(topics: Sequence[str]) -> list[str]:
    """Leave out the compressed copies of topics that are there as they are."""
    copies = {f"{topic}/{suffix}" for topic in topics for suffix in ("compressed", "compressedDepth", "theora")}
    return [topic for topic in topics if topic not in copies]
