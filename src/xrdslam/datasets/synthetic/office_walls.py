"""What hangs on an office's walls: boards full of writing, posters and pictures, windows with blinds."""

from xrdslam.datasets.synthetic import fittings
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.scene import Material, Pattern
from xrdslam.datasets.synthetic.site import Site

__all__ = ["LAMP", "posters", "windows", "written"]

P = Pattern
DAY = (5.0, 5.8, 6.8)
LAMP = (9.0, 8.8, 8.2)
TONES = (
    ("#f0e8d8", "#2f5f8f", "#b5562d"),
    ("#203a50", "#c87848", "#e8d8a0"),
    ("#e8dcc4", "#8a3f3a", "#3f6a54"),
    ("#9ac0d8", "#f4d8a8", "#3f6a4a"),
)


def written(site: Site, wall: str, along: float, width: float, height: float) -> None:
    """Hang a whiteboard full of writing."""
    face = site.material(P.WHITEBOARD, ("#e8eaea", "#22407a", "#a02a2a"), 1.0, 0.02)
    site.on_wall(fittings.board(face, w.METAL, width, height), wall, along, 1.55)


def windows(site: Site, frame: Material, wall: str, places: tuple[float, ...], width: float, height: float) -> None:
    """Put windows with blinds, sills, light and a radiator under each into a wall."""
    slat = site.material(P.PLAIN, ("#d8d4c8", "#c4c0b2", "#d8d4c8"), 0.3)
    paint = site.material(P.PLASTER, ("#d4d0c6", "#bcb8ac", "#e2dfd6"), 0.3)
    for along in places:
        view = site.view(("#86b0e0", "#dce8f0", "#47653a"))
        z = 0.98 + height / 2
        fitted = [*fittings.window(view, frame, width, height), *fittings.blind(slat, width, 0.4 * height, height / 2)]
        site.on_wall(fitted, wall, along, z)
        site.shine(fittings.daylight(DAY, width, 0.6 * height), wall, along, z - 0.2 * height)
        site.on_wall(fittings.radiator(paint, 0.8 * width), wall, along)


def posters(site: Site, places: tuple[tuple[str, float, float, float, int], ...], z: float = 1.6) -> None:
    """Hang sheets on walls: (wall, along, width, height, manner); manner 4 is a printed poster, 0 to 3 paintings."""
    for k, (wall, along, width, height, manner) in enumerate(places):
        tone = TONES[(k + manner) % 4]
        if manner == 4:
            sheet = site.material(P.POSTER, TONES[2 * (k % 2)], 1.0, 0.04)
            site.on_wall([f.block(sheet, (width, 0.012, height), (0, -0.006, 0))], wall, along, z)
        else:
            site.on_wall(
                f.picture(site.art(tone, manner), width, height, f.BLACK if k % 2 else f.BRASS), wall, along, z
            )
