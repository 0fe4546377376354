"""LPIPS against a slow twin in numpy, its invariances, and where weights come from."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch

from xrdslam.core.errors import DataError
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, EvaluationError
from xrdslam.evaluation.lpips import BACKBONES, LAYERS, Lpips
from xrdslam.evaluation.lpips_weights import VARIABLE, find_lpips

ALEX = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}
FIRES = {3: (64, 16, 64), 4: (128, 16, 64), 6: (128, 32, 128), 7: (256, 32, 128), 9: (256, 48, 192)}
FIRES |= {10: (384, 48, 192), 11: (384, 64, 256), 12: (512, 64, 256)}
HEADS = {"alex": (64, 192, 384, 256, 256), "squeeze": (64, 128, 256, 384, 384, 512, 512)}


def drawn(backbone: str, seed: int = 0) -> dict[str, torch.Tensor]:
    """Return random weights of the right shapes that keep the signal's size."""
    generator = torch.Generator().manual_seed(seed)
    shapes: dict[str, tuple[int, int, int]] = {}
    if backbone == "alex":
        shapes = {f"features.{k}": shape for k, shape in ALEX.items()}
    else:
        shapes["features.0"] = (64, 3, 3)
        for k, (inputs, narrow, wide) in FIRES.items():
            shapes |= {
                f"features.{k}.squeeze": (narrow, inputs, 1),
                f"features.{k}.expand1x1": (wide, narrow, 1),
                f"features.{k}.expand3x3": (wide, narrow, 3),
            }
    weights = {}
    for name, (outputs, inputs, side) in shapes.items():
        values = torch.randn(outputs, inputs, side, side, generator=generator)
        weights[f"{name}.weight"] = values * (2 / (inputs * side * side)) ** 0.5
        weights[f"{name}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
    heads = {f"lin{k}": torch.rand(count, generator=generator) for k, count in enumerate(HEADS[backbone])}
    return weights | heads


def images(height: int = 70, width: int = 81, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    x = rng.random((height, width, 3), dtype=np.float32)
    y = np.clip(x + rng.normal(size=x.shape).astype(np.float32) * 0.2, 0, 1)
    return torch.from_numpy(x), torch.from_numpy(y)


def convolved(
    x: np.ndarray, weights: dict[str, torch.Tensor], name: str, stride: int = 1, padding: int = 0
) -> np.ndarray:
    kernel, bias = (weights[f"{name}.{part}"].double().numpy() for part in ("weight", "bias"))
    padded = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[2:], axis=(1, 2))[:, ::stride, ::stride]
    return np.maximum(np.tensordot(kernel, windows, axes=([1, 2, 3], [0, 3, 4])) + bias[:, None, None], 0)


def pooled(x: np.ndarray, ceil: bool) -> np.ndarray:
    """3x3 maxima at every second pixel; with `ceil` a window may end beyond the image, and its inside counts."""
    rows, columns = (-(-(side - 3) // 2) + 1 if ceil else (side - 3) // 2 + 1 for side in x.shape[1:])
    out = np.empty((len(x), rows, columns))
    for i in range(rows):
        for j in range(columns):
            out[:, i, j] = x[:, 2 * i : 2 * i + 3, 2 * j : 2 * j + 3].max((1, 2))
    return out


def twin(backbone: str, weights: dict[str, torch.Tensor], x: np.ndarray, y: np.ndarray) -> float:
    """The paper's equation 1 written out in float64."""
    both = []
    for image in (x, y):
        scaled = (2 * image.astype(np.float64) - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
        f, layers = scaled.transpose(2, 0, 1), []
        if backbone == "alex":
            for k, (stride, padding) in {0: (4, 2), 3: (1, 2), 6: (1, 1), 8: (1, 1), 10: (1, 1)}.items():
                f = pooled(f, ceil=False) if k in (3, 6) else f
                f = convolved(f, weights, f"features.{k}", stride, padding)
                layers.append(f)
        else:
            f = convolved(f, weights, "features.0", 2)
            layers.append(f)
            for k in FIRES:
                f = pooled(f, ceil=True) if k in (3, 6, 9) else f
                narrow = convolved(f, weights, f"features.{k}.squeeze")
                wide = convolved(narrow, weights, f"features.{k}.expand3x3", padding=1)
                f = np.concatenate((convolved(narrow, weights, f"features.{k}.expand1x1"), wide))
                if k not in (3, 6):
                    layers.append(f)
        both.append([g / (np.sqrt((g**2).sum(0)) + 1e-10) for g in layers])
    heads = [weights[f"lin{k}"].double().numpy() for k in range(len(both[0]))]
    return float(sum((w @ ((a - b) ** 2).mean((1, 2))) for w, a, b in zip(heads, *both, strict=True)))


@pytest.mark.parametrize("backbone", BACKBONES)
def test_it_is_what_the_slow_twin_says(backbone: str) -> None:
    x, y = images(40, 45)  # odd sizes reach the incomplete windows of squeeze's pooling
    weights = drawn(backbone)
    expected = twin(backbone, weights, x.numpy(), y.numpy())
    # float32 through twelve layers of sums of up to 3456 products
    assert Lpips(backbone, weights)(x, y).item() == pytest.approx(expected, rel=1e-4)
    assert expected > 0.01


@pytest.mark.parametrize("backbone", BACKBONES)
def test_equal_images_have_no_distance_and_order_does_not_matter(backbone: str) -> None:
    measure, (x, y) = Lpips(backbone, drawn(backbone)), images()
    assert measure(x, x).item() == 0.0
    assert measure(x, y).item() == pytest.approx(measure(y, x).item(), rel=1e-6)
    assert measure(x, y).item() > measure(x, 0.8 * x + 0.2 * y).item() > 0


@pytest.mark.parametrize("backbone", BACKBONES)
def test_a_broken_pixel_breaks_the_number(backbone: str) -> None:
    x, y = images()
    x[10, 11, 1] = torch.nan
    assert np.isnan(Lpips(backbone, drawn(backbone))(x, y).item())


@pytest.mark.parametrize(("backbone", "least"), [("alex", 31), ("squeeze", 17)])
def test_the_smallest_image_is_measured_and_a_smaller_one_is_refused(backbone: str, least: int) -> None:
    measure = Lpips(backbone, drawn(backbone))
    assert measure(*images(least, 60)).item() > 0
    with pytest.raises(EvaluationError, match=f"at least {least} px"):
        measure(*images(60, least - 1))


def test_weights_of_another_network_are_refused() -> None:
    with pytest.raises(EvaluationError, match="lack lin5, lin6"):
        Lpips("squeeze", drawn("alex"))
    assert len(LAYERS) == len(BACKBONES)
    without = drawn("alex")
    del without["lin3"]
    with pytest.raises(EvaluationError, match="lack lin3"):
        Lpips("alex", without)
    with pytest.raises(EvaluationError, match="alex, squeeze"):
        Lpips("vgg", drawn("alex"))


def saved(folder: Path, *backbones: str) -> Path:
    folder.mkdir(exist_ok=True)
    for backbone in backbones:
        arrays = {name: value.numpy() for name, value in drawn(backbone).items()}
        np.savez(folder / f"lpips_{backbone}_v0.1.npz", **arrays)
    return folder


@pytest.fixture
def nothing_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Leave no weights anywhere but where a test puts them."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "hub"))
    monkeypatch.setattr("xrdslam.evaluation.lpips_weights.HEADS", {"lpips_that_is_not_there": "weights"})
    return tmp_path


def test_weights_are_found_by_path_before_the_environment(
    nothing_installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    both, one = saved(nothing_installed / "both", *BACKBONES), saved(nothing_installed / "one", "alex")
    x, y = images()
    expected = Lpips("alex", drawn("alex"))(x, y).item()
    by_path, source = find_lpips("alex", str(both))
    assert by_path(x, y).item() == expected
    assert source == "lpips_alex_v0.1.npz, evaluation.lpips_weights"
    monkeypatch.setenv(VARIABLE, str(one / "lpips_alex_v0.1.npz"))
    assert find_lpips("alex")[1] == f"lpips_alex_v0.1.npz, {VARIABLE}"
    assert find_lpips("squeeze", str(both))[1].endswith("evaluation.lpips_weights")
    with pytest.raises(EvaluationError, match="those of alex, not of squeeze"):
        find_lpips("squeeze")


def test_weights_that_were_given_and_are_wrong_are_an_error(nothing_installed: Path) -> None:
    with pytest.raises(DataError, match="no file and no folder"):
        find_lpips("alex", str(nothing_installed / "missing.npz"))
    empty = nothing_installed / "empty"
    empty.mkdir()
    with pytest.raises(EvaluationError, match=r"holds no lpips_alex_v0\.1\.npz"):
        find_lpips("alex", str(empty))
    damaged = nothing_installed / "lpips_alex_v0.1.npz"
    damaged.write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(DataError, match="cannot be read"):
        find_lpips("alex", str(damaged))
    with pytest.raises(EvaluationError, match="no file and no folder"):
        EvalMetrics(EvaluationConfig(lpips_weights=str(nothing_installed / "missing"))).check()
    EvalMetrics(EvaluationConfig(lpips_weights=str(saved(empty, "alex")))).check()


def test_without_weights_the_reason_is_said(nothing_installed: Path) -> None:
    with pytest.raises(EvaluationError, match=rf"no evaluation\.lpips_weights, no {VARIABLE}, no backbone"):
        find_lpips("alex")


@pytest.mark.parametrize("backbone", BACKBONES)
def test_what_other_packages_left_is_put_together(
    nothing_installed: Path, monkeypatch: pytest.MonkeyPatch, backbone: str
) -> None:
    weights = drawn(backbone)
    cache = nothing_installed / "hub" / "hub" / "checkpoints"
    cache.mkdir(parents=True)
    features = {k: v for k, v in weights.items() if k.startswith("features.")}
    name = {"alex": "alexnet-owt-7be5be79.pth", "squeeze": "squeezenet1_1-b8a52dc0.pth"}[backbone]
    torch.save({**features, "classifier.1.weight": torch.zeros(3)}, cache / name)
    with pytest.raises(EvaluationError, match="no heads in"):
        find_lpips(backbone)
    package = nothing_installed / "site" / "somebodys_lpips"
    (package / "weights").mkdir(parents=True)
    (package / "__init__.py").write_text("raise ImportError('not to be imported')")
    heads = {k + ".model.1.weight": v[None, :, None, None] for k, v in weights.items() if "lin" in k}
    torch.save(heads, package / "weights" / f"{backbone}.pth")
    monkeypatch.syspath_prepend(package.parent)
    monkeypatch.setattr("xrdslam.evaluation.lpips_weights.HEADS", {"somebodys_lpips": "weights"})
    found, source = find_lpips(backbone)
    x, y = images()
    assert found(x, y).item() == Lpips(backbone, weights)(x, y).item()
    assert name in source


@pytest.mark.parametrize("backbone", BACKBONES)
def test_published_weights_tell_a_shift_from_noise(backbone: str) -> None:
    """People find a shift of the whole image by a pixel alike, and it costs PSNR most: what LPIPS was made for."""
    if "XRDSLAM_DATA" not in os.environ:
        pytest.skip("XRDSLAM_DATA is not set: no published LPIPS weights")
    measure, _ = find_lpips(backbone, str(Path(os.environ["XRDSLAM_DATA"]) / "weights"))
    v, u = np.mgrid[0:96, 0:97]
    pattern = 0.5 + 0.4 * np.sin(u / 3) * np.cos(v / 4)
    x = torch.from_numpy(np.repeat(pattern[..., None], 3, -1).astype(np.float32))
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(0))
    shifted = measure(x[:, :-1], x[:, 1:]).item()
    noisy = measure(x[:, :-1], (x + 0.05 * noise).clamp(0, 1)[:, :-1]).item()
    assert 0 < shifted < noisy < 1.5
