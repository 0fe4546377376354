"""What was photographed beside what the map shows, frame by frame under a slider."""

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.pictures.palette import DEPTH, ERROR, Palette, coloured, hexadecimal
from xrdslam.pictures.panels import Panels, chosen_frames, kept_frames, read_panels
from xrdslam.report.charts import Chart, Series, line_chart, number
from xrdslam.report.run_files import RunFiles

__all__ = ["BUDGET_BYTES", "data_uri", "panels_figure", "score_charts"]

Picture = UInt8[np.ndarray, "h w 3"]
Depth = Float32[NDArray[np.float32], "h w"]

BUDGET_BYTES = 3_500_000
"""Of all frames' pictures, before base64 makes four characters of three bytes."""
WIDTH_PX, QUALITY = 400, 78
COLOUR_ERROR_MAX, DEPTH_ERROR_MAX_CM = 0.2, 10.0
"""The ends of the error scales: the same in every report, so that reports can be compared."""
PANELS = ("input", "rendering", "colour error", "input depth", "rendered depth", "depth error")


@dataclass(frozen=True)
class _Slide:
    index: int
    pictures: list[bytes | None]

    @property
    def size(self) -> int:
        return sum(len(picture) for picture in self.pictures if picture)


def panels_figure(run: RunFiles, budget_bytes: int = BUDGET_BYTES) -> str:
    """Return the slider and its six pictures; as many of the kept frames as the budget holds."""
    folder = run.path / "renders" / "panels"
    kept = kept_frames(folder)
    if not kept:
        return '<p class="none">No pictures were kept: the map has no renderer, or the run ended early.</p>'
    everything = [read_panels(folder, index) for index in kept]
    near, far = _depth_range(everything)
    slides = [_slide(panels, near, far) for panels in everything]
    total = sum(slide.size for slide in slides)
    if total > budget_bytes:
        wanted = chosen_frames([slide.index for slide in slides], max(1, int(len(slides) * budget_bytes / total)))
        slides = [slide for slide in slides if slide.index in wanted]
    scores = {int(row["index"]): row for row in run.frames}
    frames = [
        {
            "index": slide.index,
            "text": _scores(scores.get(slide.index, {})),
            "pictures": [None if picture is None else data_uri(picture) for picture in slide.pictures],
        }
        for slide in slides
    ]
    height, width = everything[0].rgb.shape[:2]
    return (
        f'<figure class="panels" style="--ratio:{width}/{height}">'
        f'<div class="slider"><label>frame <output></output></label>'
        f'<input type="range" min="0" max="{len(frames) - 1}" value="0" step="1" aria-label="frame">'
        f'<span class="scores"></span></div><div class="six">{"".join(_panel(n, near, far) for n in PANELS)}</div>'
        f'<script type="application/json">{json.dumps(frames)}</script></figure>'
    )


def score_charts(run: RunFiles) -> str:
    """Return the figures of the compared frames over the sequence."""
    if len(run.frames) < 2:
        return ""
    x = np.array([row["index"] for row in run.frames])
    charts = []
    for key, title, unit in (("psnr_db", "PSNR", "dB"), ("depth_l1_cm", "Error of the rendered depth", "cm")):
        values = np.array([row.get(key, np.nan) for row in run.frames])
        if np.isfinite(values).any():
            charts.append(line_chart(Chart(title, unit, x, [Series(title, values)], from_zero=False)))
    return "".join(charts)


def data_uri(webp: bytes) -> str:
    """Return a picture as an address that holds it."""
    return f"data:image/webp;base64,{base64.b64encode(webp).decode()}"


def _panel(name: str, near: float, far: float) -> str:
    scale = ""
    if name == "colour error":
        scale = _ramp(ERROR, "0", f"≥ {COLOUR_ERROR_MAX}")
    elif name == "depth error":
        scale = _ramp(ERROR, "0", f"≥ {number(DEPTH_ERROR_MAX_CM)} cm")
    elif "depth" in name:
        scale = _ramp(DEPTH, number(near), f"{number(far)} m")
    return f'<div><span><b>{name}</b>{scale}</span><img alt="{html.escape(name)}"></div>'


def _ramp(palette: Palette, low: str, high: str) -> str:
    stops = ",".join(hexadecimal(np.array(colour, np.uint8)) for colour in palette)
    return f'<small>{low}<i class="ramp" style="background:linear-gradient(90deg,{stops})"></i>{high}</small>'


def _slide(panels: Panels, near: float, far: float) -> _Slide:
    error = np.abs(panels.rendered_rgb.astype(np.float64) - panels.rgb).mean(-1) / 255
    pictures: list[Picture | None] = [panels.rgb, panels.rendered_rgb, coloured(error, ERROR, 0.0, COLOUR_ERROR_MAX)]
    pictures.append(None if panels.depth is None else _depth_picture(panels.depth, near, far))
    pictures.append(_depth_picture(panels.rendered_depth, near, far))
    if panels.depth is None:
        pictures.append(None)
    else:
        difference_cm = 100 * np.abs(panels.rendered_depth.astype(np.float64) - panels.depth)
        measured = np.where(panels.depth > 0, difference_cm, np.nan)
        pictures.append(coloured(measured, ERROR, 0.0, DEPTH_ERROR_MAX_CM))
    return _Slide(panels.index, [None if picture is None else _webp(picture) for picture in pictures])


def _depth_picture(depth: Depth, near: float, far: float) -> Picture:
    return coloured(np.where(depth > 0, depth, np.nan).astype(np.float64), DEPTH, near, far)


def _depth_range(frames: Sequence[Panels]) -> tuple[float, float]:
    """Return what all frames' depths lie in, but for the outermost percent [m]."""
    known = [p.rendered_depth if p.depth is None else p.depth for p in frames]
    positive = np.concatenate([depth[depth > 0] for depth in known])
    if not len(positive):
        return 0.0, 1.0
    near, far = np.percentile(positive, [1, 99])
    return float(near), float(max(far, near + 1e-3))


def _webp(rgb: Picture) -> bytes:
    height, width = rgb.shape[:2]
    if width > WIDTH_PX:
        size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
    done, data = cv2.imencode(".webp", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    if not done:
        raise DataError("OpenCV here writes no WebP; install opencv-python-headless from PyPI")
    return bytes(data.tobytes())


def _scores(row: dict[str, float]) -> str:
    names = (("psnr_db", "PSNR", "dB"), ("ssim", "SSIM", ""), ("depth_l1_cm", "depth L1", "cm"))
    return " · ".join(f"{name} {number(row[key])} {unit}".strip() for key, name, unit in names if key in row)
