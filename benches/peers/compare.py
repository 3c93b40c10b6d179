#!/usr/bin/env python3
"""The same work here and in numpy, scipy, scikit-learn, faiss, sksfa and MDP, measured alternately in one session.

    python3 benches/peers/compare.py            everything
    python3 benches/peers/compare.py --quick    small sizes, to see that everything runs
    python3 benches/peers/compare.py --only solve

Packages go into environments of their own under target/peers. All sides get all cores. Each comparison runs every contender
once without counting, then all of them one after the other, again and again; a ratio is between two runs of the same
round, and the table has the median, the least and the most of them. Above 1 the peer is slower.

dlib is not among the peers: as far as the documentation of its Python package (20.0.1) lists, that binds neither `krls` nor
`linearly_independent_subset_finder`, and through C++ it would measure dlib's matrices, not what Python users have.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = ROOT / "target" / "peers"

# Blocks that numpy is tried with; the fastest counts.
BLOCKS = [256, 512, 1024]

# Precisions that scikit-learn is asked in; it computes distances in f64 either way.
KINDS = {"f32": "float32", "f64": "float64"}

# Between two measurements: threads of a pool go to sleep some milliseconds after their work.
PAUSE = 0.3


class Peer:
    """A process that answers requests."""

    def __init__(self, command, environment=None):
        self.process = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=HERE,
            env=os.environ | (environment or {}),
        )

    def ask(self, do, **arguments):
        self.process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"a peer ended at the request {do!r}; its last words stand above")
        return json.loads(line)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait()


class Session:
    """What all comparisons share: the programs, the data, the number of runs."""

    def __init__(self, options):
        self.quick = options.quick
        self.runs = options.runs
        self.data = TARGET / "data"
        self.data.mkdir(parents=True, exist_ok=True)
        self.python = environment("venv", HERE / "requirements.txt")
        self.old_python = environment("venv-mdp", HERE / "requirements-mdp.txt")
        subprocess.run(["cargo", "build", "--release", "--locked", "--quiet", "--example", "peer"], cwd=ROOT, check=True)

    def ours(self):
        # cargo takes a relative folder from where it runs, and that is ROOT.
        target = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
        return Peer([target / "release" / "examples" / "peer", self.data])

    def peer(self, module, coretype=None, python=None):
        """A peer; `coretype` tells OpenBLAS which processor to work for."""
        setting = {"OPENBLAS_CORETYPE": coretype} if coretype else {}
        return Peer([python or self.python, "worker.py", module, self.data], setting)

    def alternately(self, contenders, reference):
        """Run `{label: work}` in rounds and print times, and ratios to the contender `reference`."""
        seconds = {label: [] for label in contenders}
        answers = {}
        for turn in range(self.runs + 1):
            for label, work in contenders.items():
                time.sleep(PAUSE)
                answers[label] = work()
                if turn > 0:
                    seconds[label].append(answers[label]["seconds"] / answers[label].get("units", 1))
        width = max(map(len, contenders))
        for label, figures in seconds.items():
            ratios = [figure / base for figure, base in zip(figures, seconds[reference])]
            ratio = "" if label == reference else f"   ratio {spread(ratios, '{:.2f}')}"
            print(f"  {label:<{width}}  {spread(figures, '{:.3g}')} s{ratio}")
        return answers


def spread(figures, form):
    low, middle, high = (form.format(f) for f in (min(figures), statistics.median(figures), max(figures)))
    return f"{middle} ({low} to {high})"


def environment(name, requirements):
    """The interpreter of a virtual environment with these packages, made once; None if they cannot be had."""
    folder = TARGET / name
    python, stamp = folder / "bin" / "python3", folder / "installed.txt"
    wanted = requirements.read_text()
    if stamp.exists() and stamp.read_text() == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    print(f"installing {requirements.name} into {folder}", file=sys.stderr)
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:"]
    # MDP's own package and what it needs have no wheels, but are pure Python.
    install += ["--no-binary", "future,mdp"] if "mdp" in wanted else []
    if subprocess.run([*install, "-r", requirements]).returncode != 0:
        return None
    stamp.write_text(wanted)
    return python


def has_avx512():
    cpuinfo = Path("/proc/cpuinfo")
    return cpuinfo.exists() and "avx512f" in cpuinfo.read_text()


def print_rates(session):
    """What the matrix products of both sides can do: ratios of programs that are mostly products begin here."""
    print(f"{os.cpu_count()} cores; matrix product, all cores, GF/s")
    with session.ours() as ours, session.peer("numpy_peer") as numpy:
        sides = {"ours (faer)": ours, "numpy, OpenBLAS as installed": numpy}
        avx512 = session.peer("numpy_peer", "SKYLAKEX") if has_avx512() else None
        if avx512:
            sides["numpy, OpenBLAS with AVX-512"] = avx512
        for label, side in sides.items():
            # Once without counting.
            side.ask("rates")
            time.sleep(PAUSE)
            rates = side.ask("rates")
            print(f"  {label:<28}  f32 {1e-9 * rates['single']:.0f}, f64 {1e-9 * rates['double']:.0f}")
        if avx512:
            avx512.__exit__()


def heading(text):
    print(f"\n{text}", flush=True)


def difference(left, right, count=None):
    """Largest relative difference."""
    pairs = list(zip(left, right))[:count]
    return max(abs(a - b) / abs(a) for a, b in pairs)


def compare_growth(session):
    m, n, frames_by_one = (500, 512, 8) if session.quick else (4000, 1024, 8)
    heading(
        f"growth + moments, m = {m}, d = 1536, dictionary full, seconds per frame. Ours: SlowStream::push (kernel rows, coordinates,"
        "\n  residuals, nearest member, two symmetric updates, the block is retained). numpy: the same sums alone."
    )
    with session.ours() as ours:
        facts = ours.ask("frames", n=m + n)
        sigma, block = facts["sigma"], facts["block"]
        ours.ask("dictionary", m=m)
        ours.ask("coordinates", n=block)
        ours.ask("stream", m=m)

        def per_frame(peer, count, do, **arguments):
            return lambda: peer.ask(do, n=count, **arguments) | {"units": count}

        contenders = {"ours": per_frame(ours, n, "push", m=m)}
        installed = session.peer("numpy_peer")
        avx512 = session.peer("numpy_peer", "SKYLAKEX") if has_avx512() else None
        with installed:
            for label, peer in (("OpenBLAS as installed", installed), ("OpenBLAS with AVX-512", avx512)):
                if peer is None:
                    print(f"  numpy, {label}: not measurable on this machine, which has no AVX-512")
                    continue
                peer.ask("dictionary", m=m, sigma=sigma)
                peer.ask("inverse")
                best = peer.ask("choose_block", m=m, n=n, blocks=BLOCKS)["block"]
                contenders[f"numpy in blocks of {best}, {label}"] = per_frame(peer, n, "blocked", m=m, block=best)
            contenders["numpy frame by frame, textbook"] = per_frame(installed, frames_by_one, "textbook")
            contenders["numpy frame by frame, in place"] = per_frame(installed, frames_by_one, "textbook_in_place")
            session.alternately(contenders, "ours")
            found = installed.ask("coordinates", n=block)["difference"]
            print(f"  coordinates of {block} frames differ by at most {found:.1e} (kernel rows in f64 here, in f32 there)")
        if avx512:
            avx512.__exit__()


def compare_solve(session):
    for m, k in [(500, 32)] if session.quick else [(2000, 128), (4000, 128)]:
        heading(
            f"re-solve, m = {m}, k = {k}, moments of {m + m // 4} frames. Ours: solve() from the sums, covariances and weights included."
            "\n  scipy: from the finished matrices. ARPACK: on the operator R⁻¹CR⁻ᵀ, never formed. Standard problem: that matrix formed."
            "\n  Both with the Cholesky factor included."
        )
        with session.ours() as ours:
            regulariser = ours.ask("frames", n=m + m // 4)["lambda"]
            ours.ask("moments", m=m, n=m + m // 4)
            with session.peer("scipy_peer") as scipy:
                scipy.ask("moments", regulariser=regulariser)
                answers = session.alternately(
                    {
                        "ours": lambda: ours.ask("solve", k=k),
                        "scipy.linalg.eigh, subset_by_index": lambda: scipy.ask("dense", k=k),
                        "scipy, standard problem, evr": lambda: scipy.ask("standard", k=k),
                        "scipy.sparse.linalg.eigsh": lambda: scipy.ask("arpack", k=k),
                    },
                    "ours",
                )
        exact = answers["scipy.linalg.eigh, subset_by_index"]["objectives"]
        for label in ("ours", "scipy, standard problem, evr", "scipy.sparse.linalg.eigsh"):
            largest = difference(exact, answers[label]["objectives"])
            print(f"  eigenvalues, largest relative difference from eigh: {label} {largest:.1e}")


def compare_nystroem(session):
    m, n = (500, 512) if session.quick else (2000, 2048)
    heading(
        f"features of {n} frames, m = {m}. Ours: Newton coordinates L⁻¹k(x), in f64. scikit-learn: Nystroem.transform, K^(-1/2) k(x),"
        "\n  in f32 and in f64; both span the same functions."
    )
    with session.ours() as ours, session.peer("sklearn_peer") as sklearn:
        sigma = ours.ask("frames", n=m + n)["sigma"]
        ours.ask("dictionary", m=m)
        contenders = {"ours": lambda: ours.ask("coordinates", n=n)}
        for name, kind in KINDS.items():
            sklearn.ask("nystroem", m=m, sigma=sigma, kind=kind)
            contenders[f"sklearn Nystroem.transform, {name}"] = partial(sklearn.ask, "transform", m=m, n=n, kind=kind)
        session.alternately(contenders, "ours")
        for name, kind in KINDS.items():
            found = sklearn.ask("products", kind=kind)["difference"]
            print(f"  scalar products differ by at most {found:.1e} in {name}")


def compare_sfa(session):
    m, n, k = (200, 1000, 16) if session.quick else (1000, 8000, 32)
    heading(
        f"SFA on kernel rows, m = {m}, n = {n}, k = {k}. Ours: rows → coordinates → moments → solve(). Peers: fit on the same rows."
    )
    with session.ours() as ours, session.peer("sksfa_peer") as sksfa:
        facts = ours.ask("frames", n=n)
        ours.ask("rows", m=m, n=n)
        contenders = {
            "ours, λ as in a run": lambda: ours.ask("sfa", k=k, **{"lambda": facts["lambda"]}),
            "ours, λ = 0": lambda: ours.ask("sfa", k=k, **{"lambda": 0.0}),
            "sksfa SFA": lambda: sksfa.ask("sfa", k=k),
        }
        mdp = session.peer("mdp_peer", python=session.old_python) if session.old_python else None
        if mdp:
            contenders["MDP SFANode"] = lambda: mdp.ask("sfa", k=k)
        else:
            print("  MDP: not measurable with this Python, see requirements-mdp.txt")
        answers = session.alternately(contenders, "ours, λ as in a run")
        exact = answers["ours, λ = 0"]["slowness"]
        for label, answer in answers.items():
            if label != "ours, λ = 0":
                largest = difference(exact, answer["slowness"], count=k)
                print(f"  slowness, largest relative difference from ours at λ = 0: {label} {largest:.1e}")
        if mdp:
            mdp.__exit__()


def compare_kernel_rows(session):
    m, n = (500, 256) if session.quick else (4000, 256)
    heading(f"kernel rows of {n} frames, m = {m}, d = 1536. Ours: f32 product, the rest and the result in f64. numpy: all in f32.")
    with session.ours() as ours, session.peer("numpy_peer") as numpy, session.peer("sklearn_peer") as sklearn:
        sigma = ours.ask("frames", n=m + n)["sigma"]
        contenders = {
            "ours": lambda: ours.ask("kernel_rows", m=m, n=n),
            "numpy, product and exp in place": lambda: numpy.ask("kernel_rows", m=m, n=n, sigma=sigma),
        }
        for name, kind in KINDS.items():
            contenders[f"sklearn rbf_kernel, {name}"] = partial(
                sklearn.ask, "kernel_rows", m=m, n=n, sigma=sigma, kind=kind
            )
        answers = session.alternately(contenders, "ours")
        first = {label: answer["first"] for label, answer in answers.items()}
        print(f"  the first value: {', '.join(f'{label} {value:.9f}' for label, value in first.items())}")


def compare_neighbours(session):
    n, p = (5000, 40) if session.quick else (60_000, 40)
    heading(
        f"neighbours of the ends of {n} transitions among their beginnings, in {p} coordinates, exact. Ours: Local::new, which also finds how"
        "\n  much each neighbour counts (a regression for each end). Peers: index and search alone, with as many neighbours."
    )
    with session.ours() as ours, session.peer("neighbours_peer") as peer:
        # One more: where weights end.
        k = ours.ask("window", n=n, p=p)["neighbours"] + 1
        contenders = {
            "ours": lambda: ours.ask("neighbours"),
            "faiss IndexFlatL2": lambda: peer.ask("flat", k=k),
            "sklearn NearestNeighbors, brute": lambda: peer.ask("scikit_learn", k=k, algorithm="brute"),
            "sklearn NearestNeighbors, kd_tree": lambda: peer.ask("scikit_learn", k=k, algorithm="kd_tree"),
        }
        session.alternately(contenders, "ours")
        left, right = ours.ask("nearest", n=1000)["nearest"], peer.ask("nearest", n=1000)["nearest"]
        same = sum(a == b for a, b in zip(left, right))
        print(f"  the nearest point is the same for {same} of {len(left)} ends (kd_tree)")


COMPARISONS = {
    "kernel_rows": compare_kernel_rows,
    "growth": compare_growth,
    "solve": compare_solve,
    "nystroem": compare_nystroem,
    "sfa": compare_sfa,
    "neighbours": compare_neighbours,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes")
    parser.add_argument("--only", choices=COMPARISONS, action="append", help="this comparison alone; may be repeated")
    parser.add_argument("--runs", type=int, default=5, help="rounds that count (default: 5)")
    options = parser.parse_args()
    session = Session(options)
    print_rates(session)
    for name in options.only or COMPARISONS:
        COMPARISONS[name](session)


if __name__ == "__main__":
    main()
