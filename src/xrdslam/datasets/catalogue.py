"""Where data sets can be had: their publishers' addresses. None of these publishes a hash."""

from typing import NamedTuple

from xrdslam.core.errors import DataError

__all__ = ["Source", "source_of", "sources"]

TUM = "https://cvg.cit.tum.de/rgbd/dataset"
EUROC = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset"
MICROSOFT = "https://download.microsoft.com/download/2/8/5/28564B23-0828-408F-8631-23B1EFF1DAC8"


class Source(NamedTuple):
    """An archive: its address, the folder that it becomes inside the family's root ("" the root itself), its terms."""

    url: str
    folder: str
    terms: str
    sha256: str | None = None


def sources() -> dict[str, Source]:
    """Return every archive by the `<family>/<scene>` that it brings."""
    found = {"replica": Source("https://cvg-data.inf.ethz.ch/nice-slam/data/Replica.zip", "", REPLICA_TERMS)}
    for number, names in {
        "1": ("desk", "desk2", "room", "rpy", "xyz"),
        "2": ("xyz",),
        "3": ("long_office_household",),
    }.items():
        for name in names:
            folder = f"rgbd_dataset_freiburg{number}_{name}"
            scene = "fr3_office" if number == "3" else f"fr{number}_{name}"
            found[f"tum_rgbd/{scene}"] = Source(f"{TUM}/freiburg{number}/{folder}.tgz", folder, "CC BY 4.0")
    for scene in ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs"):
        found[f"seven_scenes/{scene}"] = Source(f"{MICROSOFT}/{scene}.zip", scene, "Microsoft's, non-commercial")
    for place, names in EUROC_PLACES.items():
        for name in names:
            found[f"euroc/{name}"] = Source(f"{EUROC}/{place}/{name}/{name}.zip", name, "ETH's, non-commercial")
    return found


def source_of(name: str) -> Source:
    """Return where a scene can be had; a DataError says what can be downloaded, or what to do instead."""
    family = name.partition("/")[0]
    found = sources()
    source = found.get(name) or (found["replica"] if family == "replica" else None)
    if source is not None:
        return source
    if family in BY_HAND:
        raise DataError(f"{name}: {BY_HAND[family]}")
    raise DataError(f"{name}: no address is known; there is {', '.join(found)}")


REPLICA_TERMS = "Replica's research terms; all eight scenes in one archive of 12 GB"
BY_HAND = {
    "scannet": "ScanNet is given out after its terms are signed: see www.scan-net.org, export each .sens with its own"
    " reader into data/ScanNet/<scene>/frames",
    "co_fusion": "Co-Fusion's sequences are linked from its page, visual.cs.ucl.ac.uk/pubs/cofusion; unpack room4 into"
    " data/CoFusion/room4",
    "synthetic": "is made on the spot, nothing has to be downloaded",
}
EUROC_PLACES = {
    "machine_hall": ("MH_01_easy", "MH_02_easy", "MH_03_medium", "MH_04_difficult", "MH_05_difficult"),
    "vicon_room1": ("V1_01_easy", "V1_02_medium", "V1_03_difficult"),
    "vicon_room2": ("V2_01_easy", "V2_02_medium", "V2_03_difficult"),
}
