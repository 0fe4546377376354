"""The 16-lane vector type against numpy."""

import numpy as np

from xrdslam.ops import simd

X = np.random.default_rng(0).uniform(-8, 8, (16, 16)).astype(np.float32)


def test_arithmetic_and_masks_are_numpys() -> None:
    limit = np.float32(0.5)

    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        x, y = simd.load(a, 0), simd.load(a, 16)
        simd.store(out, 0, simd.select((x >= limit) & (y < x), x * y - limit, simd.minimum(x / y, limit)))
        simd.store(out, 16, simd.absolute(x) + limit * simd.lane_columns() + simd.lane_rows())

    out = np.empty((2, 16), np.float32)
    run(X, out)
    x, y = X[0], X[1]
    np.testing.assert_allclose(
        out[0], np.where((x >= 0.5) & (y < x), x * y - np.float32(0.5), np.minimum(x / y, limit)), rtol=1e-6, atol=1e-6
    )
    lane = np.arange(16)
    np.testing.assert_allclose(out[1], np.abs(x) + 0.5 * (lane % 4) + lane // 4, rtol=1e-6)


def test_exp2_is_within_two_units_in_the_last_place_over_its_range() -> None:
    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        for k in range(0, a.size, 16):
            simd.store(out, k, simd.exp2(simd.load(a, k)))

    x = np.linspace(-126, 126.5, 16 * 4096, dtype=np.float32)
    out = np.empty_like(x)
    run(x, out)
    assert np.abs(out / np.exp2(x.astype(np.float64)) - 1).max() < 2.4e-7  # 2 eps


def test_sum_lanes_transposes_any_number_of_vectors() -> None:
    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        v = simd.load(a, 0), simd.load(a, 16), simd.load(a, 32), simd.load(a, 48), simd.load(a, 64)
        simd.store(out, 0, simd.sum_lanes_of_16(v))
        simd.store(out, 16, simd.sum_lanes_of_16(v + v + v + (simd.load(a, 240),)))

    out = np.empty((2, 16), np.float32)
    run(X, out)
    sums = X.sum(1)
    np.testing.assert_allclose(out[0], np.r_[sums[:5], np.zeros(11)], atol=1e-5)
    np.testing.assert_allclose(out[1], np.r_[sums[:5], sums[:5], sums[:5], sums[15]], atol=1e-5)


def test_fetch_add_hands_out_every_number_once() -> None:
    @simd.kernel
    def run(counter):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        return simd.fetch_add(counter, 1, 3), simd.fetch_add(counter, 1, 1)

    counter = np.array([0, 5])
    assert run(counter) == (5, 8)
    assert counter.tolist() == [0, 9]


def test_log2_is_exact_to_rounding_between_one_and_256() -> None:
    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        for k in range(0, a.size, 16):
            simd.store(out, k, simd.log2(simd.load(a, k)))

    x = np.geomspace(1e-30, 256, 16 * 4096).astype(np.float32)
    out = np.empty_like(x)
    run(x, out)
    error = np.abs(out - np.log2(x.astype(np.float64)))
    assert error[x >= 1].max() < 6e-7  # one unit in the last place at 8
    assert (error <= 3e-7 * np.maximum(1, np.abs(np.log2(x)))).all()


def test_rounding_roots_and_extrema_are_numpys() -> None:
    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        x, y = simd.load(a, 0), simd.load(a, 16)
        simd.store(out, 0, simd.floor(x))
        simd.store(out, 16, simd.ceil(x))
        simd.store(out, 32, simd.sqrt(x * x))
        simd.store(out, 48, simd.maximum(x, y))
        simd.store(out, 64, simd.minimum(x, y))
        simd.store(out, 80, simd.pack_pair(simd.floor(simd.absolute(x)), simd.floor(simd.absolute(y))))

    out = np.empty((6, 16), np.float32)
    run(X, out)
    x, y = X[0], X[1]
    expected = [np.floor(x), np.ceil(x), np.abs(x), np.maximum(x, y), np.minimum(x, y)]
    np.testing.assert_allclose(out[:5], expected, rtol=1e-6)
    np.testing.assert_array_equal(out[5].view(np.int32), np.abs(x).astype(int) | np.abs(y).astype(int) << 16)


def test_transpose_exchanges_rows_and_columns() -> None:
    @simd.kernel
    def run(a, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        v = (simd.load(a, 0), simd.load(a, 16), simd.load(a, 32), simd.load(a, 48))
        w = (simd.load(a, 64), simd.load(a, 80), simd.load(a, 96), simd.load(a, 112))
        t = simd.transpose(v + w + v + w)
        for k in range(16):
            simd.store(out, 16 * k, t[k])

    out = np.empty((16, 16), np.float32)
    run(X, out)
    np.testing.assert_array_equal(out, np.concatenate((X[:8], X[:8])).T)
