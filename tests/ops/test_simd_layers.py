"""Tile operations against numpy."""

import numpy as np

from xrdslam.ops import simd, simd_layers

G = np.random.default_rng(0)


def test_sine_and_cosine_keep_their_accuracy_over_thousands_of_radians() -> None:
    @simd.kernel
    def run(a, s, c):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        for k in range(0, a.size, 16):
            simd.store(s, k, simd_layers.sine(simd.load(a, k)))
            simd.store(c, k, simd_layers.cosine(simd.load(a, k)))

    x = np.concatenate((np.linspace(-7, 7, 1 << 14), np.linspace(-5e3, 5e3, 1 << 16))).astype(np.float32)
    sine, cosine = np.empty_like(x), np.empty_like(x)
    run(x, sine, cosine)
    exact = x.astype(np.float64)
    assert np.abs(sine - np.sin(exact)).max() < 3e-7
    assert np.abs(cosine - np.cos(exact)).max() < 3e-7


def test_a_product_adds_to_eight_rows() -> None:
    @simd.kernel
    def run(w, x, y):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        simd_layers.multiply_add(w, 2, 1, 10, x, 32, 5, y, 32)

    w = G.standard_normal(64).astype(np.float32)
    x, y = (G.standard_normal((rows, 32)).astype(np.float32) for rows in (6, 10))
    expected = y.copy()
    matrix = np.array([[w[2 + r + 10 * k] for k in range(5)] for r in range(8)])
    expected[1:9] += matrix @ x[1:6]
    run(w, x.reshape(-1), y.reshape(-1))
    np.testing.assert_allclose(y, expected, rtol=1e-5, atol=1e-5)


def test_a_relu_keeps_what_its_mask_needs() -> None:
    @simd.kernel
    def run(x, b, bits, y, d, through):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        for half in range(0, 32, 16):
            simd_layers.relu_rows(x, half, b, 0, bits, half, y, half)
            simd_layers.mask_rows(d, half, bits, half, through, half)

    x, d = (G.standard_normal((32, 32)).astype(np.float32) for _ in range(2))
    x[3] = 0
    b, bits = G.standard_normal(32).astype(np.float32), np.empty(32, np.int32)
    y, through = np.empty_like(x), np.empty_like(x)
    run(x.reshape(-1), b, bits, y.reshape(-1), d.reshape(-1), through.reshape(-1))
    np.testing.assert_allclose(y, np.maximum(x, 0) + b[:, None], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(through, np.where(x > 0, d, 0))
