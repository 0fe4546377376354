"""SSIM and its gradient on the CPU: separable windows over interleaved channels, 16 values at a time.

An image row is width * channels floats; the neighbour of the same channel is `channels` floats away, so colours need no
untangling. Each thread filters down the columns into one padded row per moment, then along that row.
"""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import numpy as np
from numba import prange

from xrdslam.ops.simd import absolute, kernel, load, parallel_kernel, select, splat, store, zeros

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_BAND = 8
"""Rows that one thread takes at a time."""


@parallel_kernel
def similarity(x, y, weights, c1, c2, channels, out, partials, sums):
    """Write the map, its derivatives by E[x], E[x^2], E[xy] (if `partials` has room), and row sums (SSIM, |x - y|)."""
    height, length = x.shape[0], x.shape[1] * x.shape[2]
    for band in prange((height + _BAND - 1) // _BAND):
        pad = weights.size // 2 * channels
        rows = np.zeros(5 * (length + 2 * pad), np.float32)
        for row in range(band * _BAND, min(height, band * _BAND + _BAND)):
            _filter_moments(x, y, weights, row, length, pad, rows)
            _combine(rows, weights, c1, c2, channels, row, length, pad, out, partials)
            sums[row, 0], sums[row, 1] = _row_sums(x, y, out, row, length)


@kernel
def _filter_moments(x, y, weights, row, length, pad, rows):
    """Filter x, y, x^2, y^2, xy down the columns into one row of each."""
    radius, stride = weights.size // 2, length + 2 * pad
    first, last = max(row - radius, 0), min(row + radius, x.shape[0] - 1)
    for start in range(0, length, 16):
        at = min(start, length - 16)
        mx = my = xx = yy = xy = zeros()
        for r in range(first, last + 1):
            a, b = load(x, r * length + at), load(y, r * length + at)
            wa, wb = a * weights[r - row + radius], b * weights[r - row + radius]
            mx += wa
            my += wb
            xx += wa * a
            yy += wb * b
            xy += wa * b
        store(rows, pad + at, mx)
        store(rows, stride + pad + at, my)
        store(rows, 2 * stride + pad + at, xx)
        store(rows, 3 * stride + pad + at, yy)
        store(rows, 4 * stride + pad + at, xy)


@kernel
def _combine(rows, weights, c1, c2, channels, row, length, pad, out, partials):
    """Filter the rows along themselves and write SSIM and its derivatives."""
    stride, plane = length + 2 * pad, out.size
    for start in range(0, length, 16):
        at = min(start, length - 16)
        mx = my = xx = yy = xy = zeros()
        for k in range(weights.size):
            tap = at + k * channels
            mx += load(rows, tap) * weights[k]
            my += load(rows, stride + tap) * weights[k]
            xx += load(rows, 2 * stride + tap) * weights[k]
            yy += load(rows, 3 * stride + tap) * weights[k]
            xy += load(rows, 4 * stride + tap) * weights[k]
        mean_part, mean_scale = mx * my * _TWO + c1, mx * mx + my * my + c1
        cov_part, var_scale = (xy - mx * my) * _TWO + c2, xx - mx * mx + yy - my * my + c2
        inverse = splat(_ONE) / (mean_scale * var_scale)
        ssim = mean_part * cov_part * inverse
        store(out, row * length + at, ssim)
        if partials.size > 0:
            d_xx = zeros() - ssim / var_scale
            d_xy = mean_part * inverse * _TWO
            d_mx = my * cov_part * inverse * _TWO - ssim * mx * _TWO / mean_scale - mx * d_xx * _TWO - my * d_xy
            store(partials, row * length + at, d_mx)
            store(partials, plane + row * length + at, d_xx)
            store(partials, 2 * plane + row * length + at, d_xy)


@kernel
def _row_sums(x, y, out, row, length):
    """Return the sums over a row of SSIM and of |x - y|."""
    ssim = difference = zeros()
    whole = length // 16 * 16
    for at in range(row * length, row * length + whole, 16):
        ssim += load(out, at)
        difference += absolute(load(x, at) - load(y, at))
    lanes = np.empty(32, np.float32)
    store(lanes, 0, ssim)
    store(lanes, 16, difference)
    total_ssim, total_difference = lanes[:16].sum(), lanes[16:].sum()
    flat_x, flat_y, flat_out = x.reshape(-1), y.reshape(-1), out.reshape(-1)
    for at in range(row * length + whole, row * length + length):
        total_ssim += flat_out[at]
        total_difference += abs(flat_x[at] - flat_y[at])
    return total_ssim, total_difference


@parallel_kernel
def gradient(x, y, partials, cotangent, weights, scale, scale_l1, channels, d_x):
    """Write scale * (F(p0 g) + 2 x F(p1 g) + y F(p2 g)) + scale_l1 * sign(x - y), F the window, g the cotangent.

    The window is symmetric and the padding zero, so F is its own transpose. An empty cotangent stands for ones.
    """
    height, length = x.shape[0], x.shape[1] * x.shape[2]
    for band in prange((height + _BAND - 1) // _BAND):
        pad = weights.size // 2 * channels
        rows = np.zeros(3 * (length + 2 * pad), np.float32)
        for row in range(band * _BAND, min(height, band * _BAND + _BAND)):
            _filter_partials(partials, cotangent, weights, row, height, length, pad, rows)
            _pull_row(x, y, rows, weights, scale, scale_l1, channels, row, length, pad, d_x)


@kernel
def _filter_partials(partials, cotangent, weights, row, height, length, pad, rows):
    """Filter the three derivatives times the cotangent down the columns."""
    radius, stride, plane = weights.size // 2, length + 2 * pad, height * length
    first, last = max(row - radius, 0), min(row + radius, height - 1)
    for start in range(0, length, 16):
        at = min(start, length - 16)
        p0 = p1 = p2 = zeros()
        for r in range(first, last + 1):
            tap = r * length + at
            g = splat(weights[r - row + radius])
            if cotangent.size > 0:
                g = g * load(cotangent, tap)
            p0 += load(partials, tap) * g
            p1 += load(partials, plane + tap) * g
            p2 += load(partials, 2 * plane + tap) * g
        store(rows, pad + at, p0)
        store(rows, stride + pad + at, p1)
        store(rows, 2 * stride + pad + at, p2)


@kernel
def _pull_row(x, y, rows, weights, scale, scale_l1, channels, row, length, pad, d_x):
    """Filter along the row and write the gradient."""
    stride, sign = length + 2 * pad, splat(scale_l1)
    for start in range(0, length, 16):
        at = min(start, length - 16)
        p0 = p1 = p2 = zeros()
        for k in range(weights.size):
            tap = at + k * channels
            p0 += load(rows, tap) * weights[k]
            p1 += load(rows, stride + tap) * weights[k]
            p2 += load(rows, 2 * stride + tap) * weights[k]
        a, b = load(x, row * length + at), load(y, row * length + at)
        l1 = select(a > b, sign, select(a < b, zeros() - sign, zeros()))
        store(d_x, row * length + at, (p0 + a * p1 * _TWO + b * p2) * scale + l1)
