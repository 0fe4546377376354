"""`python -m xrdslam.viewer RUN`: a finished run on a page, or as a video."""

import argparse
import logging
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from xrdslam.core.errors import XrdslamError
from xrdslam.viewer.recorded import Recorded
from xrdslam.viewer.replay import Replay
from xrdslam.viewer.video import write_video

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the arguments say; an error that a user can mend is one line, exit status 1."""
    parser = argparse.ArgumentParser(prog="python -m xrdslam.viewer", description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="the run_dir of a finished run")
    parser.add_argument("--video", type=Path, help="write this MP4 instead of serving a page; needs no display")
    parser.add_argument("--fps", type=float, default=20.0, help="of the video, frames a second (20)")
    parser.add_argument("--port", type=int, default=8080, help="of the page on this machine (8080, else the next free)")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    try:
        recorded = Recorded.read(chosen.run)
        if chosen.video is not None:
            print(f"{chosen.video}: {write_video(recorded, chosen.video, chosen.fps)} frames")
        else:
            _serve(recorded, chosen.port)
    except XrdslamError as error:
        sys.exit(f"xrdslam: {error}")


def _serve(recorded: Recorded, port: int) -> None:
    """Show the page until Ctrl-C."""
    replay = Replay(recorded, port=port)
    print(f"{recorded.run.title}: {replay.stage.url} (Ctrl-C ends it)", flush=True)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        replay.close()


if __name__ == "__main__":
    main()
