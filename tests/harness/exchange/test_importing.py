"""What others have stored becomes the same problem in our form, or is refused with the figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat, savemat
from typer.testing import CliRunner

from glambda.cli import app
from harness.exchange.importing import import_files
from harness.judging.facts import facts_of
from harness.judging.judge import judge
from harness.recordings.recording import Recording, read_recording
from harness.study.replay import replay
from problems.qp import ContactQP
from tests.fakes.assertions import assert_kkt
from tests.harness.exchange import foreign_files as ff

INF = np.inf


def only(recording: Recording) -> tuple[ContactQP, np.ndarray]:
    """The one QP and the answer that its reference has."""
    (qp,), (known,) = recording.qps, recording.references
    assert known is not None and known.proof == "exact"
    assert_kkt(qp, known.x, 1e-10)
    return qp, known.x


def assert_optimal(parts: dict[str, np.ndarray], x: np.ndarray) -> None:
    """x meets the rows of P, q, G, h, A, b, lb, ub, and its gradient is a sum of the active ones.

    By non-negative least squares on the gradients of what is active.
    """
    from scipy.optimize import nnls

    tol = 1e-7
    G, h, E, b = (parts[name] for name in ("G", "h", "A", "b"))
    assert (G @ x <= h + tol).all() and np.allclose(E @ x, b, atol=tol)
    assert (x >= parts["lb"] - tol).all() and (x <= parts["ub"] + tol).all()
    pushes = [*G[np.abs(G @ x - h) < tol], *E, *-E]
    pushes += [-e for e, at in zip(np.eye(4), np.abs(x - parts["lb"]) < tol, strict=True) if at]
    pushes += [e for e, at in zip(np.eye(4), np.abs(x - parts["ub"]) < tol, strict=True) if at]
    gradient = parts["P"] @ x + parts["q"]
    assert nnls(np.array(pushes).T, -gradient)[1] < 1e-6 * (1 + np.linalg.norm(gradient))


def x_of(made: Recording, parts: dict[str, np.ndarray]) -> np.ndarray:
    """x of the problem from the multipliers of its rows (`harness.exchange.quadratic`)."""
    qp, y = only(made)
    r, form = qp.dense_A @ y + qp.d, made.parameters["import.form"]
    z = (
        qp.dense_A @ y
        if form == "velocity form"
        else -r[:4] / r[4] * made.parameters["import.unit"]
    )
    values, V = np.linalg.eigh(parts["P"])
    R = np.sqrt(values)[:, None] * V.T
    return np.linalg.solve(R, z - np.linalg.solve(R.T, parts["q"]))


def test_least_squares_come_in_to_the_last_bit(tmp_path: Path) -> None:
    A, b = ff.numbers()
    np.savez(tmp_path / "own.npz", A=A, b=b, **ff.BOUNDED)
    made = import_files([tmp_path / "own.npz"])
    qp, _ = only(made)
    assert made.scene == "own" and made.parameters["import.form"] == "as given"
    assert np.array_equal(qp.dense_A, A) and np.array_equal(qp.d, -b)
    assert np.array_equal(qp.lower, ff.BOUNDED["lb"]) and np.array_equal(qp.upper, ff.BOUNDED["ub"])


@pytest.mark.parametrize("stacked", [True, False])
def test_a_sequence(stacked: bool, tmp_path: Path) -> None:
    many = [ff.numbers(seed) for seed in range(3)]
    if stacked:
        arrays = {"A": np.array([A for A, _ in many]), "b": np.array([b for _, b in many])}
        arrays |= ff.BOUNDED
    else:
        arrays = {
            f"{n}_{i}": v for i, pair in enumerate(many) for n, v in zip("Ab", pair, strict=True)
        }
    np.savez(tmp_path / "own.npz", **arrays)  # type: ignore[arg-type]
    for apart in (False, True):
        qps = import_files([tmp_path / "own.npz"], apart=apart).qps
        assert [qp.restart for qp in qps] == [True, apart, apart]
        for qp, (A, b) in zip(qps, many, strict=True):
            assert np.array_equal(qp.dense_A, A) and np.array_equal(qp.d, -b)
            assert np.isinf(qp.upper).all() != stacked


def test_several_files_are_one_sequence(tmp_path: Path) -> None:
    paths = []
    for seed in (3, 1):
        A, b = ff.numbers(seed)
        np.savez(tmp_path / f"n{seed}.npz", A=A, b=b)
        paths.append(tmp_path / f"n{seed}.npz")
    made = import_files(paths, name="both")
    assert made.scene == "both" and [qp.restart for qp in made.qps] == [True, False]
    assert np.array_equal(made.qps[0].dense_A, ff.numbers(3)[0])


def test_a_quadratic_with_bounds_is_factored(tmp_path: Path) -> None:
    A, b = ff.numbers()
    A[:, 3] = A[:, 0]
    np.savez(tmp_path / "own.npz", P=A.T @ A, q=-A.T @ b, **ff.BOUNDED)
    made = import_files([tmp_path / "own.npz"])
    qp, _ = only(made)
    assert made.parameters["import.form"] == "factored" and made.parameters["import.rank"] == 3
    assert qp.m == 3 == facts_of(qp).rank
    assert np.allclose(qp.dense_A.T @ qp.dense_A, A.T @ A, atol=1e-13)
    assert np.allclose(qp.dense_A.T @ qp.d, -A.T @ b, atol=1e-13)


def test_a_row_of_zeros_is_no_bound_and_may_not_ask_for_what_is_not(tmp_path: Path) -> None:
    parts = {name: ff.quadratic()[name] for name in ("P", "q", "lb", "ub")}
    G, h = np.zeros((2, 4)), np.array([1.0, np.inf])
    np.savez(tmp_path / "own.npz", **parts, G=G, h=h)
    made = import_files([tmp_path / "own.npz"])
    assert made.parameters["import.form"] == "factored"
    np.savez(tmp_path / "none.npz", **parts, G=G, h=np.array([-1.0, 0.0]))
    with pytest.raises(ValueError, match=r"none\.npz: rows: number 0 is 0, .* no x meets it"):
        import_files([tmp_path / "none.npz"])


@pytest.mark.parametrize("seed", range(6))
def test_rows_become_multipliers(seed: int, tmp_path: Path) -> None:
    parts = ff.quadratic(seed)
    np.savez(tmp_path / "own.npz", **parts)  # type: ignore[arg-type]
    made = import_files([tmp_path / "own.npz"])
    assert made.parameters["import.form"] == "least distance"
    assert np.isinf(made.qps[0].lower).sum() == 1  # the equality is free
    assert_optimal(parts, x_of(made, parts))


def test_the_velocity_form_where_all_rows_can_be_active(tmp_path: Path) -> None:
    parts = ff.quadratic()
    parts |= {"lb": np.full(4, -INF), "ub": np.full(4, INF)}
    np.savez(tmp_path / "own.npz", **parts)  # type: ignore[arg-type]
    made = import_files([tmp_path / "own.npz"])
    assert made.parameters["import.form"] == "velocity form" and made.qps[0].k == 3
    assert_optimal(parts, x_of(made, parts))


def test_one_problem_in_every_clothing(tmp_path: Path) -> None:
    parts = ff.quadratic(3)
    np.savez(tmp_path / "a.npz", **parts)  # type: ignore[arg-type]
    ff.maros(tmp_path / "b.mat", 3)
    flat = {name: pa.array([value.ravel()]) for name, value in parts.items()}
    pq.write_table(pa.table({**flat, "name": ["one"]}), tmp_path / "c.parquet")
    answers = []
    for name in ("a.npz", "b.mat", "c.parquet"):
        made = import_files([tmp_path / name])
        answers.append(x_of(made, parts))
    for x in answers:
        assert_optimal(parts, x)
        assert np.allclose(x, answers[0], atol=1e-9)


def test_missing_parts_of_qpbenchmark(tmp_path: Path) -> None:
    """None as it pickles it, and as null."""
    parts = ff.quadratic()
    np.savez(tmp_path / "own.npz", P=parts["P"], q=parts["q"], lb=parts["lb"],
             **dict.fromkeys(("G", "h", "A", "b", "ub")))  # type: ignore[arg-type]  # fmt: skip
    columns: dict[str, Any] = {n: pa.array([parts[n].ravel()]) for n in ("P", "q", "lb")}
    columns |= {n: pa.array([None], pa.list_(pa.float64())) for n in ("G", "h", "A", "b", "ub")}
    pq.write_table(pa.table(columns), tmp_path / "own.parquet")
    for name in ("own.npz", "own.parquet"):
        qp, _ = only(import_files([tmp_path / name]))
        assert np.isinf(qp.upper).all() and np.array_equal(qp.lower, parts["lb"])


def test_a_diagonal_of_thousands_stays_sparse(tmp_path: Path) -> None:
    n = 6000
    from scipy.sparse import csc_matrix, diags, eye, vstack

    A = vstack([diags([1.0, -1.0], [0, 1], shape=(n - 1, n)), eye(n)])
    savemat(tmp_path / "chain.mat", {"P": eye(n, format="csc"), "q": -np.ones((n, 1)),
            "A": csc_matrix(A), "l": np.r_[np.zeros(n - 1), np.full(n, -1e20)][:, None],
            "u": np.full((2 * n - 1, 1), 1e20)})  # fmt: skip
    from harness.exchange.importing import read_problems

    ((qp,), notes) = read_problems(tmp_path / "chain.mat")[0]
    assert not isinstance(qp.A, np.ndarray) and qp.A.shape == (n, n - 1)
    assert notes["import.form"] == "velocity form"


@pytest.mark.rounding
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("blocks", [False, True])
def test_siconos(dim: int, blocks: bool, tmp_path: Path) -> None:
    W, q, mu = ff.delassus(3, dim)
    write = ff.siconos_blocks if blocks else ff.siconos_text
    (tmp_path / "one.dat").write_text(write(W, q, mu))
    made = import_files([tmp_path / "one.dat"])
    assert len(made.qps) == made.parameters["import.passes"] == 5
    first, second = made.qps[0], made.qps[-1]
    normals = np.arange(0, 3 * dim, dim)
    assert np.array_equal(first.row_id, normals)
    assert np.allclose(first.dense_A.T @ first.dense_A, W[np.ix_(normals, normals)])
    assert np.allclose(second.dense_A.T @ second.dense_A, W)
    assert np.allclose(second.dense_A.T @ second.d, q)
    known = made.references[-2]
    assert known is not None
    # two contacts are the same, so that only what they push together is unique
    pushed = np.column_stack([second.upper[1::dim] / 0.4, known.x[normals]])
    assert (pushed >= 0).all()
    assert np.allclose(*(first.dense_A @ pushed).T, rtol=1e-5, atol=1e-8)
    assert np.isinf(second.upper[normals]).all()
    found = judge(second, made.references[-1].x)  # type: ignore[union-attr]
    assert 0 <= found.approach < 1e-6


def test_in_the_plane_the_passes_come_to_coulombs_law(tmp_path: Path) -> None:
    W, q, mu = ff.delassus(2, 2, seed=5)
    W, q, mu = W[:2, :2], q[:2], mu[:1]
    q[0] = -abs(q[0])
    (tmp_path / "one.dat").write_text(ff.siconos_text(W, q, mu))
    made = import_files([tmp_path / "one.dat"])
    known = made.references[-1]
    assert known is not None
    assert abs(known.x[1]) <= mu[0] * known.x[0] * (1 + 1e-3) and known.x[0] > 0


@pytest.mark.parametrize("way", ["columns", "rows", "triplets", "turned"])
def test_fclib_in_all_its_ways(way: str, tmp_path: Path) -> None:
    W, q, mu = ff.delassus()
    qps = import_files([ff.fclib_local(tmp_path / "one.hdf5", W, q, mu, way)]).qps
    assert np.allclose(qps[-1].dense_A.T @ qps[-1].dense_A, W)
    assert np.allclose(qps[-1].dense_A.T @ qps[-1].d, q)
    assert len(qps) == 5


def test_fclib_global_is_local_of_its_w(tmp_path: Path) -> None:
    M, H, f, w, mu = ff.contacts()
    W, q, _ = ff.delassus()
    for way in ("columns", "rows", "triplets"):
        made = import_files([ff.fclib_global(tmp_path / "one.hdf5", (M, H, f, w, mu), way)])
        qp = made.qps[-1]
        assert np.allclose(qp.dense_A.T @ qp.dense_A, W) and np.allclose(qp.A.T @ qp.d, q)
    tall = np.vstack([H, H[:2]])  # more coordinates than rows: only one order fits
    mass, force = np.diag(np.r_[np.diag(M), 1.0, 1.0]), np.r_[f, 0.0, 0.0]
    W = W + H[:2].T @ H[:2]
    for way in ("triplets", "turned"):
        path = ff.fclib_global(tmp_path / "two.hdf5", (mass, tall, force, w, mu), way)
        qp = import_files([path]).qps[-1]
        assert np.allclose(qp.dense_A.T @ qp.dense_A, W)


def test_fclib_equalities_are_free_rows(tmp_path: Path) -> None:
    M, H, f, w, mu = ff.contacts()
    G = np.eye(len(f))[:, :1]
    made = import_files([ff.fclib_global(tmp_path / "one.hdf5", (M, H, f, w, mu), "columns", G)])
    for qp, known in zip(made.qps, made.references, strict=True):
        assert np.isinf(qp.lower).sum() == 1 and known is not None
        assert abs(qp.gradient(known.x)[-1]) < 1e-10


def test_what_is_no_contact_has_no_physics(tmp_path: Path) -> None:
    A, b = ff.numbers()
    np.savez(tmp_path / "own.npz", A=A, b=b, lb=np.zeros(4))
    rows = replay(import_files([tmp_path / "own.npz"]), ["lotstedt"], ["high"], isolate=False)
    assert (rows["verdict"] == "verified").all()
    columns = ["approach", "pull", "coulomb_excess", "work_error", "energy_error", "physics_error"]
    assert rows[columns].isna().all().all()


def asymmetric(folder: Path) -> Path:
    W, q, mu = ff.delassus()
    W[0, 1] += 1e-3
    (folder / "bad.dat").write_text(ff.siconos_text(W, q, mu))
    return folder / "bad.dat"


def by_rows(folder: Path) -> Path:
    """Blocks that are stored by rows are another matrix, unless symmetric."""
    W, q, mu = ff.delassus()
    (folder / "bad.dat").write_text(ff.siconos_blocks(W, q, mu).replace("\n0\n", "\n7\n", 1))
    return folder / "bad.dat"


def archive(**changes: Any) -> Any:
    def make(folder: Path) -> Path:
        arrays = {k: v for k, v in {**ff.quadratic(), **changes}.items() if v is not None}
        np.savez(folder / "bad.npz", **arrays)
        return folder / "bad.npz"

    return make


def least_squares(**changes: Any) -> Any:
    def make(folder: Path) -> Path:
        A, b = ff.numbers()
        arrays = {"A": A, "b": b, **ff.BOUNDED, **changes}
        np.savez(folder / "bad.npz", **{k: v for k, v in arrays.items() if v is not None})
        return folder / "bad.npz"

    return make


def text(content: str, name: str = "bad.dat") -> Any:
    def make(folder: Path) -> Path:
        (folder / name).write_text(content)
        return folder / name

    return make


def local(**changes: Any) -> Any:
    def make(folder: Path) -> Path:
        W, q, mu = ff.delassus()
        path = ff.fclib_local(folder / "bad.hdf5", W, q, mu)
        with h5py.File(path, "r+") as file:
            for name, value in changes.items():
                where = "fclib_local/" + name.replace("__", "/")
                del file[where]
                if value is not None:
                    file[where] = value
        return path

    return make


def empty(folder: Path) -> Path:
    with h5py.File(folder / "bad.hdf5", "w"):
        return folder / "bad.hdf5"


def linked(folder: Path) -> Path:
    path = local()(folder)
    with h5py.File(path, "r+") as file:
        del file["fclib_local/vectors/q"]
        file["fclib_local/vectors/q"] = h5py.ExternalLink("other.hdf5", "/q")
    return path


def logical(folder: Path) -> Path:
    """As a damaged flag makes numbers logical."""
    said = loadmat(ff.maros(folder / "bad.mat"))
    said["q"] = said["q"] != 0
    savemat(folder / "bad.mat", {k: v for k, v in said.items() if not k.startswith("__")})
    return folder / "bad.mat"


P = ff.quadratic()["P"]
INDEFINITE = P - 0.9 * np.linalg.eigvalsh(P)[1] * np.eye(4)
FOUR = "4\n1\n0\n4\n4\n4 4\n" + "0 " * 16 + "1 1 1 1 0.5"
REFUSED = {
    "asymmetric": (asymmetric, "W: is not symmetric: .*e-0[34]"),
    "indefinite": (archive(P=INDEFINITE), "semidefinite: .* = "),
    "negative": (archive(P=-P), "semidefinite"),
    "NaN": (archive(q=np.array([0, np.nan, 0, 0])), "q: holds nan at index \\[1\\]"),
    "infinite": (least_squares(A=np.full((6, 4), np.inf)), "A: holds inf"),
    "huge": (least_squares(b=np.full(6, 1e200)), "b: holds 1e\\+200"),
    "crossed": (least_squares(lb=np.full(4, 3.0)), "lb: is 3 at index 1"),
    "wrong size": (least_squares(b=np.zeros(5)), "b: has 5 entries, and should have 6"),
    "lonely": (archive(h=None), "G, h: one is there without the other"),
    "not in the range": (archive(P=np.diag([1.0, 1, 1, 0]), G=None, h=None, A=None, b=None),
                         "q: is not in the range of P: .* = "),
    "singular with rows": (archive(P=np.diag([1.0, 1, 1, 0]), q=np.zeros(4)), "rank 3 of 4"),
    "objects": (least_squares(A=np.array([[{}]], object)), "objects"),
    "texts": (least_squares(b=np.array(["x"] * 6)), "b: holds <U1"),
    "complex": (least_squares(b=np.full(6, 1j)), "b: holds complex"),
    "other names": (least_squares(more=np.zeros(3)), "holds A, b, lb, more, ub"),
    "twice an id": (least_squares(row_id=np.zeros(4)), "row_id: holds a number twice"),
    "no archive": (text("nothing", "bad.npz"), "no NumPy archive"),
    "no numbers": (text("2 1 0 two"), "something else than numbers"),
    "short": (text("2\n1\n0\n2\n2\n2 2\n1 0 0 1\n"), "q: needs 2 numbers"),
    "long": (text("2\n1\n0\n2\n2\n2 2\n1 0 0 1\n1 1\n0.5\n1 1 1\n"), "3 numbers after its end"),
    "moved block": (by_rows, "block 0: is not where"),
    "negative friction": (text("2\n1\n0\n2\n2\n2 2\n1 0 0 1\n1 1\n-0.5\n"), "mu: is -0.5"),
    "four dimensions": (text(FOUR), "dimension: is 4"),
    "no matrix": (local(W__p=np.arange(7, dtype=np.int32)), "W: p and i"),
    "outside": (local(W__i=np.full(36, 9, np.int32)), "W: p and i"),
    "missing": (local(vectors__mu=None), "vectors/mu: is missing"),
    "linked": (linked, "vectors/q: is a link elsewhere"),
    "no group": (local(W=np.zeros(3)), "W: is no group"),
    "no fclib": (empty, "neither fclib_local"),
    "no mat": (text("nothing", "bad.mat"), "cannot be read as MATLAB"),
    "logical": (logical, "q: holds logical values"),
    "no parquet": (text("nothing", "bad.parquet"), "cannot be read as Parquet"),
    "unknown": (text("", "bad.qps"), "ending: .qps is unknown"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_bad_data_are_refused_in_a_line(name: str, tmp_path: Path) -> None:
    make, words = REFUSED[name]
    path = make(tmp_path)
    with pytest.raises(ValueError, match=words) as caught:
        import_files([path])
    said = str(caught.value)
    assert said.startswith(str(path)) and "\n" not in said and len(said) < 500


def test_a_tolerance_takes_what_it_names(tmp_path: Path) -> None:
    path = asymmetric(tmp_path)
    made = import_files([path], tolerance=1e-2)
    assert 1e-5 < made.parameters["import.asymmetry"] < 1e-2
    with pytest.raises(ValueError, match="tolerance = 2"):
        import_files([path], tolerance=2.0)


def test_the_command(tmp_path: Path) -> None:
    A, b = ff.numbers()
    np.savez(tmp_path / "own.npz", A=A, b=b)
    out = str(tmp_path / "recordings")
    run = CliRunner().invoke
    told = run(app, ["import", str(tmp_path / "own.npz"), "-o", out])
    assert told.exit_code == 0 and "1 QPs, 1 with a reference, as given" in told.output
    assert read_recording(tmp_path / "recordings" / "own.h5").qps[0].k == 4
    shown = run(app, ["info", out + "/own.h5"])
    assert shown.exit_code == 0, shown.output
    np.savez(tmp_path / "own.npz", A=2 * A, b=b)
    for words, code in (([], 2), (["--overwrite"], 0)):
        told = run(app, ["import", str(tmp_path / "own.npz"), "-o", out, *words])
        assert told.exit_code == code, told.output
    absent = run(app, ["import", str(tmp_path / "absent.npz"), "-o", out])
    assert absent.exit_code == 2 and "No such file" in absent.output
