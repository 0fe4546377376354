"""Whether torch, numba and their threads compute, together and rightly. Imports both, so it comes late."""

import multiprocessing
import os
from collections.abc import Iterator

from xrdslam.doctor.finding import Finding, fail, ok, warn

__all__ = ["accelerator", "kernel", "openmp", "processes", "threads"]

TOLERANCE = 1e-4
"""Of a kernel's value and gradient against its twin in float64; measured 4e-6."""
START_S = 60


def threads() -> Iterator[Finding]:
    """Report whether both libraries take the threads that a run asks for."""
    import numba
    import torch

    from xrdslam.engine.seeding import num_threads, prepare

    asked = num_threads(0)
    prepare(0, asked)
    torch_has, numba_has = torch.get_num_threads(), numba.get_num_threads()
    found = f"a run asks for {asked}: torch takes {torch_has}, numba {numba_has}"
    if (torch_has, numba_has) == (asked, asked):
        yield ok("threads", found)
    else:
        yield warn("threads", found, "unset OMP_NUM_THREADS and NUMBA_NUM_THREADS, or say threads=<number>")


def kernel() -> Iterator[Finding]:
    """Report whether a kernel compiles, where it is kept, on which threads it runs, and whether it is right."""
    import numba
    import torch

    try:
        from xrdslam.ops.one_blob import one_blob, one_blob_torch
        from xrdslam.ops.one_blob_kernels import spread

        points = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
        differs = _difference(points, one_blob, one_blob_torch)
    except Exception as error:  # whatever a compiler raises
        yield fail(
            "kernel",
            f"{type(error).__name__}: {' '.join(str(error).split())[:200]}",
            "set NUMBA_CACHE_DIR to a folder that can be written; else reinstall numba and llvmlite",
        )
        return
    if differs <= TOLERANCE:
        yield ok("kernel", f"value and gradient agree with the torch twin to {differs:.0e}")
    else:
        yield fail("kernel", f"differs from its torch twin by {differs:.0e}", "reinstall numba, llvmlite and torch")
    yield _cache(spread.stats.cache_path)
    layer = str(numba.threading_layer())  # type: ignore[attr-defined]  # numba does not list it
    if layer == "omp":
        yield ok("numba layer", "omp")
    else:
        yield warn("numba layer", f"{layer}: figures were measured with omp", "set NUMBA_THREADING_LAYER=omp")


def _difference(points, kernel, twin) -> float:  # type: ignore[no-untyped-def]  # noqa: ANN001  # torch comes later
    """Return the greatest difference of a kernel's value and gradient from its twin's in float64."""
    import torch

    ours, exact = points.clone().requires_grad_(), points.double().requires_grad_()
    values = kernel(ours), twin(exact)
    cotangent = torch.linspace(-1, 1, values[0].numel()).reshape(values[0].shape)
    values[0].backward(cotangent)
    values[1].backward(cotangent.double())
    pairs = [(values[0].detach(), values[1].detach()), (ours.grad, exact.grad)]
    return max(float((mine.double() - its).abs().max()) for mine, its in pairs)


def _cache(folder: str | None) -> Finding:
    if folder is None:
        return warn("kernel cache", "kernels are compiled in every process", "set NUMBA_CACHE_DIR to a folder")
    if os.access(folder, os.W_OK):
        return ok("kernel cache", f"{folder} can be written")
    return warn("kernel cache", f"{folder} cannot be written", "set NUMBA_CACHE_DIR to a folder that can")


def openmp() -> Iterator[Finding]:
    """Report the pools of threads that are in this process by now; two OpenMP libraries do not share theirs."""
    import threadpoolctl

    pools = threadpoolctl.threadpool_info()
    paths = sorted({pool["filepath"] for pool in pools if pool["user_api"] == "openmp"})
    blas = sorted({f"{pool['internal_api']} x {pool['num_threads']}" for pool in pools if pool["user_api"] == "blas"})
    found = ", ".join(os.path.basename(path) for path in paths) or "none"
    if len(paths) > 1:
        yield warn(
            "OpenMP",
            f"{len(paths)} libraries in one process: {', '.join(paths)}",
            "each has threads of its own, which costs little while OMP_WAIT_POLICY=passive "
            f"(it is {os.environ.get('OMP_WAIT_POLICY', 'not set')})",
        )
    else:
        yield ok("OpenMP", f"{found}; linear algebra: {', '.join(blas) or 'none'}")


def accelerator() -> Iterator[Finding]:
    """Report where tensors can live, and whether the twins, which run there, give what they give on the CPU."""
    import torch

    from xrdslam.engine.build import current_accelerator
    from xrdslam.ops.one_blob import one_blob_torch

    device = current_accelerator()
    if device is None:
        yield ok("accelerator", "none: device=cpu, with kernels of numba")
        return
    points = torch.rand(64, 3, generator=torch.Generator().manual_seed(0))
    try:
        differs = float((one_blob_torch(points.to(device)).cpu() - one_blob_torch(points)).abs().max())
    except RuntimeError as error:
        yield warn(
            "accelerator",
            f"{device} is there and does not compute ({str(error).splitlines()[0]})",
            "say device=cpu, or install the torch that fits the driver",
        )
        return
    yield ok("accelerator", f"device={device} computes the torch twins, to {differs:.0e} of the CPU")


def processes() -> Iterator[Finding]:
    """Report whether a process can be started afresh, as engine=multiprocess and loaders of data do."""
    context = multiprocessing.get_context("spawn")
    child = context.Process(target=_answer)
    try:
        child.start()
        child.join(START_S)
    except OSError as error:
        yield fail("processes", f"none can be started ({error})", "raise the limit of processes (ulimit -u) or memory")
        return
    if child.exitcode == 0:
        yield ok("processes", "a spawned process starts and ends")
        return
    child.kill()
    ended = "gave no answer" if child.exitcode is None else f"ended with {child.exitcode}"
    yield fail("processes", f"a spawned process {ended}", "see what it says above; `ulimit -a` shows the limits")


def _answer() -> None:
    import xrdslam.core.registry  # noqa: F401  # as far as a worker's first step
