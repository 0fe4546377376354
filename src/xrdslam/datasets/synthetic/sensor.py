"""What a real RGB-D camera makes of a perfect frame: noise and holes of depth, noise, drift and blur of colour, loss.

What a frame suffers depends on the seed and on its number in the sequence, not on the order in which frames are asked
for; each effect draws from a stream of its own, so that switching one does not change another.
"""

import math

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import ndtri

from xrdslam.core.camera import Camera
from xrdslam.datasets.synthetic.config import SensorConfig

__all__ = ["arrived", "drift", "expose", "measure_depth", "shutter_poses", "to_codes", "to_linear"]

NOISE, HOLES, COLOUR, DROPS, BRIGHTNESS, RED, BLUE = range(7)
WAVES = 24
DRIFT_SECONDS = 1.0
FRAMES_PER_SECOND = 30.0
READ_SHARE = 0.2
"""Share of a mid-grey pixel's variance that is there in the dark."""

_CODES = np.arange(256) / 255
LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)

Depth = Float32[np.ndarray, "h w"]
Codes = UInt8[np.ndarray, "h w 3"]
Linear = Float32[np.ndarray, "h w 3"]


def measure_depth(exact: Depth, camera: Camera, config: SensorConfig, seed: int, frame: int) -> Depth:
    """Return what a structured-light camera measures of exact depth [m]; 0 where it measures nothing.

    Disparity d = f b / z carries the error, so that depth's grows as z^2 / (f b) (Khoshelham & Elberink, Accuracy and
    Resolution of Kinect Depth Data, 2012, eqs. 3 and 8; their 0.5 steps of 1/8 px are 0.06 px).
    """
    effects = (config.depth_noise, config.disparity_step, config.min_depth, config.grazing_deg, config.holes)
    if not (any(effects) or config.shadows):
        return exact
    scale = config.depth_focal * config.depth_baseline
    with np.errstate(divide="ignore"):
        disparity = scale / exact.astype(np.float64)
    if config.depth_noise > 0:
        rng = np.random.default_rng([seed, config.seed, NOISE, frame])
        disparity += config.depth_noise * _field(rng, exact.shape, config.depth_correlation)
    if config.disparity_step > 0:
        disparity = np.rint(disparity / config.disparity_step) * config.disparity_step
    with np.errstate(divide="ignore"):
        measured = np.where(disparity > 0, scale / disparity, 0.0)
    is_lost = (exact <= 0) | (measured < config.min_depth)
    if config.shadows:
        is_lost |= _shadow(exact, camera, config.depth_baseline)
    if config.grazing_deg > 0:
        is_lost |= _sine(exact, camera) < math.sin(math.radians(config.grazing_deg))
    if config.holes > 0:
        rng = np.random.default_rng([seed, config.seed, HOLES, frame])
        is_lost |= _field(rng, exact.shape, 0.35 * config.hole_size) < ndtri(config.holes)
    depth: Depth = np.where(is_lost, 0.0, measured).astype(np.float32)
    return depth


def _field(rng: np.random.Generator, shape: tuple[int, ...], correlation_px: float) -> Float64[np.ndarray, "h w"]:
    """Return Gaussian noise of unit variance, alike over a length of `correlation_px`."""
    white = rng.standard_normal(shape)
    if correlation_px == 0:
        return white
    impulse = np.zeros(2 * math.ceil(4 * correlation_px) + 3)
    impulse[len(impulse) // 2] = 1
    share = float((gaussian_filter(impulse, correlation_px) ** 2).sum())  # variance that one direction leaves
    field: Float64[np.ndarray, "h w"] = gaussian_filter(white, correlation_px, mode="wrap") / share
    return field


def _shadow(exact: Depth, camera: Camera, baseline: float) -> Bool[np.ndarray, "h w"]:
    """Return where something nearer stands between the point and a projector `baseline` [m] to the camera's right.

    The projector sees column u at u - f b / z: a point is hidden where one further right is seen no further right.
    """
    with np.errstate(divide="ignore"):
        seen = np.arange(camera.width) - camera.fx * baseline / exact.astype(np.float64)
    ahead = np.minimum.accumulate(seen[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(exact.shape, np.bool_)
    hidden[:, :-1] = seen[:, :-1] >= ahead[:, 1:]
    return hidden


def _sine(exact: Depth, camera: Camera) -> Float64[np.ndarray, "h w"]:
    """Return the sine of the angle at which each pixel's ray meets the surface through its neighbours."""
    rays = camera.rays().double().numpy()
    points = rays * exact[..., None].astype(np.float64)
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(across, down)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(rays, axis=-1)
    sine: Float64[np.ndarray, "h w"] = np.abs((normal * rays).sum(-1)) / np.maximum(length, 1e-300)
    return sine


def expose(linear: Linear, config: SensorConfig, seed: int, frame: int) -> Codes:
    """Return the picture that the camera stores of linear light: its exposure, its white balance, its noise."""
    stops = np.zeros(3)
    if config.exposure_drift > 0:
        stops += config.exposure_drift * drift(seed, config.seed, BRIGHTNESS, frame)
    if config.white_balance_drift > 0:
        stops[0] += config.white_balance_drift * drift(seed, config.seed, RED, frame)
        stops[2] += config.white_balance_drift * drift(seed, config.seed, BLUE, frame)
    codes = to_codes(linear * np.exp2(stops).astype(np.float32)) if stops.any() else to_codes(linear)
    if config.rgb_noise > 0:
        rng = np.random.default_rng([seed, config.seed, COLOUR, frame])
        share = READ_SHARE + 2 * (1 - READ_SHARE) * codes / np.float32(255)
        codes = codes + config.rgb_noise * np.sqrt(share) * rng.standard_normal(codes.shape, dtype=np.float32)
    stored: Codes = np.clip(np.rint(codes), 0, 255).astype(np.uint8)
    return stored


def to_linear(codes: Codes) -> Linear:
    """Return the linear light of sRGB codes (IEC 61966-2-1)."""
    light: Linear = LINEAR[codes]
    return light


def to_codes(linear: Linear) -> Float32[np.ndarray, "h w 3"]:
    """Return sRGB codes, not rounded, of linear light; what is above 1 is cut off."""
    x = np.clip(linear, 0, 1)
    codes: Linear = np.float32(255) * np.where(
        x <= 0.0031308, 12.92 * x, 1.055 * x ** np.float32(1 / 2.4) - np.float32(0.055)
    )
    return codes


def drift(seed: int, sensor_seed: int, stream: int, frame: int) -> float:
    """Return a smooth random function of the frame's time, of unit variance: waves about one to a second or slower."""
    rng = np.random.default_rng([seed, sensor_seed, stream])
    hertz = np.abs(rng.standard_normal(WAVES)) / (2 * math.pi * DRIFT_SECONDS) + 0.02
    phase = rng.uniform(0, 2 * math.pi, WAVES)
    waves = np.cos(2 * math.pi * hertz * frame / FRAMES_PER_SECOND + phase)
    return float(math.sqrt(2 / WAVES) * waves.sum())


def shutter_poses(loop: Float64[np.ndarray, "n 4 4"], frame: int, config: SensorConfig) -> Float64[np.ndarray, "k 4 4"]:
    """Return T_world_camera at the moments while the shutter is open, the frame's own in their middle."""
    near = loop[(frame + np.arange(-1, 2)) % len(loop)]
    share = (np.arange(config.blur_samples) + 0.5) / config.blur_samples - 0.5
    at = share * config.exposure_ms * FRAMES_PER_SECOND / 1000
    poses = np.tile(np.eye(4), (len(at), 1, 1))
    poses[:, :3, :3] = Slerp([-1, 0, 1], Rotation.from_matrix(near[:, :3, :3]))(at).as_matrix()
    for axis in range(3):
        poses[:, axis, 3] = np.interp(at, [-1, 0, 1], near[:, axis, 3])
    return poses


def arrived(count: int, config: SensorConfig, seed: int) -> Bool[np.ndarray, " n"]:
    """Return which frames arrive: a chain of two states, whose bad one lasts `drop_burst` frames on average.

    The first frame arrives always: it is what methods begin with. A longer sequence begins as a shorter one.
    """
    if config.dropped == 0:
        return np.ones(count, np.bool_)
    draws = np.random.default_rng([seed, config.seed, DROPS]).uniform(size=count)
    end = 1 / config.drop_burst
    begin = end * config.dropped / (1 - config.dropped)
    ok = np.ones(count, np.bool_)
    for k in range(1, count):
        ok[k] = draws[k] >= begin if ok[k - 1] else draws[k] < end
    return ok
