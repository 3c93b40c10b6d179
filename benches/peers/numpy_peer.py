"""Growth and moments in numpy: as the textbook has them, frame by frame, and in the strongest form we know, in blocks.

Both work on a full dictionary, the first `m` frames. What they sum is what slow feature analysis needs: the products of the
coordinates, and of their derivatives.
"""

import numpy as np
from scipy.linalg import blas, cholesky

from worker import STATE, timed


# Edge of the matrices whose product gives the rate; the same as on our side.
EDGE = 1500


def rates(folder):
    """Rates of numpy's matrix product in both precisions, operations per second: the best of two."""

    def rate(kind):
        a = np.ones((EDGE, EDGE), dtype=kind)
        c = np.empty_like(a)
        return 2 * EDGE**3 / min(timed(lambda: np.matmul(a, a, out=c))[1] for _ in range(2))

    return {"single": rate(np.float32), "double": rate(np.float64)}


def _members(folder, m):
    frames = np.load(folder / "frames.npy", mmap_mode="r")
    return np.ascontiguousarray(frames[:m])


def _norms(x):
    return np.einsum("ij,ij->i", x, x, dtype=np.float64)


def _rows(members, member_norms, x, sigma, out=None):
    """Gaussian kernel rows in single precision, `b × m`: one matrix product, and the rest in place."""
    scale = 1 / (2 * sigma**2)
    rows = np.matmul(x, members.T, out=out)
    rows *= np.float32(2 * scale)
    rows -= (_norms(x) * scale).astype(np.float32)[:, None]
    rows -= (member_norms * scale).astype(np.float32)
    np.minimum(rows, 0, out=rows)
    return np.exp(rows, out=rows)


def kernel_rows(folder, m, n, sigma):
    """Kernel rows of the `n` frames behind the first `m`."""
    if STATE.get("rows_of") != m:
        members = _members(folder, m)
        STATE.update(rows_of=m, row_members=members, row_norms=_norms(members))
    x = np.array(np.load(folder / "frames.npy", mmap_mode="r")[m : m + n])
    rows, seconds = timed(lambda: _rows(STATE["row_members"], STATE["row_norms"], x, sigma))
    return {"seconds": seconds, "first": float(rows[0, 0])}


def dictionary(folder, m, sigma):
    """The Cholesky factor of the kernel matrix, and empty sums; in Fortran's order, which BLAS works on in place."""
    members = _members(folder, m)
    norms = _norms(members)
    # In double precision, or the factor would be that of another matrix; on whole numbers the single product is exact.
    squared = norms[:, None] + norms - 2 * (members @ members.T).astype(np.float64)
    kernel = np.exp(-np.maximum(squared, 0) / (2 * sigma**2))
    STATE.update(
        members=members,
        norms=norms,
        sigma=sigma,
        factor=np.asfortranarray(cholesky(kernel, lower=True)),
        square=np.zeros((m, m), order="F"),
        derivative=np.zeros((m, m), order="F"),
        last=None,
    )
    return {}


def coordinates(folder, n):
    """Largest difference of our Newton coordinates (`coordinates.npy`) from those here."""
    m = len(STATE["members"])
    x = np.array(np.load(folder / "frames.npy", mmap_mode="r")[m : m + n])
    v = _coordinates(x, None)
    return {"difference": float(np.abs(v.T - np.load(folder / "coordinates.npy")).max())}


def _coordinates(x, buffer):
    rows = _rows(STATE["members"], STATE["norms"], x, STATE["sigma"], out=buffer)
    # The transpose of a C array is a Fortran array, so nothing is copied but the change of precision.
    return blas.dtrsm(1.0, STATE["factor"], rows.astype(np.float64).T, lower=1, overwrite_b=1)


def blocked(folder, m, n, block):
    """Blocks: a matrix product, a triangular solve, and two symmetric updates of the lower triangle in place."""
    x = np.array(np.load(folder / "frames.npy", mmap_mode="r")[m : m + n])
    buffer = np.empty((block, m), dtype=np.float32)

    def work():
        accepted = 0
        for start in range(0, n, block):
            part = x[start : start + block]
            v = _coordinates(part, buffer[: len(part)])
            accepted += int((1 - np.einsum("ij,ij->j", v, v) > 1).sum())
            rates = np.empty_like(v, order="F")
            rates[:, 0] = v[:, 0] - STATE["last"] if STATE["last"] is not None else 0
            np.subtract(v[:, 1:], v[:, :-1], out=rates[:, 1:])
            for name, columns in (("square", v), ("derivative", rates)):
                STATE[name] = blas.dsyrk(1.0, columns, beta=1.0, c=STATE[name], lower=1, overwrite_c=1)
            STATE["last"] = v[:, -1].copy()
        return accepted

    _, seconds = timed(work)
    return {"seconds": seconds}


def choose_block(folder, m, n, blocks):
    """The block with which `blocked` is fastest here, after one try of each that does not count."""
    blocks = [block for block in blocks if block <= n]
    seconds = {}
    for _ in range(2):
        seconds = {block: blocked(folder, m, n, block)["seconds"] for block in blocks}
    return {"block": min(seconds, key=seconds.get)}


def inverse(folder):
    """What the textbook form carries instead of the factor, with sums of its own."""
    m = len(STATE["members"])
    identity = np.eye(m, order="F")
    half = blas.dtrsm(1.0, STATE["factor"], identity, lower=1, overwrite_b=1)
    STATE["inverse"] = np.asfortranarray(half.T @ half)
    STATE["textbook"] = np.zeros((m, m)), np.zeros((m, m))
    return {}


def _frame_by_frame(folder, n, product, update):
    m = len(STATE["members"])
    x = np.array(np.load(folder / "frames.npy", mmap_mode="r")[m : m + n])
    members, norms, sigma = STATE["members"], STATE["norms"], STATE["sigma"]

    def work():
        last, accepted = None, 0
        for frame in x:
            squared = norms + float(frame @ frame) - 2 * (members @ frame)
            k = np.exp(-squared / (2 * sigma**2))
            accepted += 1 - k @ product(k) > 1
            update(k, k - last if last is not None else k)
            last = k
        return accepted

    _, seconds = timed(work)
    return {"seconds": seconds}


def textbook(folder, n):
    """The thesis's algorithm 2 and its sums: the inverse times the kernel row, and two outer products per frame."""
    square, derivative = STATE["textbook"]

    def update(k, rate):
        nonlocal square, derivative
        square += np.outer(k, k)
        derivative += np.outer(rate, rate)

    return _frame_by_frame(folder, n, lambda k: STATE["inverse"] @ k, update)


def textbook_in_place(folder, n):
    """The same, with a product and rank-1 updates in place that make use of symmetry: half of the memory traffic."""

    def update(k, rate):
        # The transpose is a view in Fortran's order; its lower triangle is the upper one of the array.
        for total, column in zip(STATE["textbook"], (k, rate)):
            blas.dsyr(1.0, column, lower=1, a=total.T, overwrite_a=1)

    return _frame_by_frame(folder, n, lambda k: blas.dsymv(1.0, STATE["inverse"], k, lower=1), update)
