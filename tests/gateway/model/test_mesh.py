"""Meshes of others: bounded, regular files alone, and simplified so that nothing of the link is outside."""

from __future__ import annotations

import os
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from gateway.model import mesh
from gateway.model.mesh import MeshError, mesh_corners, read_vertices, simple_corners

SIZE = np.array([0.06, 0.05, 0.4])


def ball(count: int, seed: int = 0) -> np.ndarray:
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def turned(points: np.ndarray) -> np.ndarray:
    """The same points elsewhere, the axes not along those of the file."""
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    return points @ turn.T + [0.3, -0.2, 0.9]


def outside(corners: np.ndarray, points: np.ndarray) -> float:
    """How far the farthest point is outside the hull of the corners, at least [m]."""
    equations = ConvexHull(corners).equations
    return float((points @ equations[:, :3].T + equations[:, 3]).max())


def stl(path: Path, points: np.ndarray) -> Path:
    rows = np.zeros(len(points) // 3, dtype=[("n", "<f4", 3), ("corners", "<f4", (3, 3)), ("a", "<u2")])
    rows["corners"] = points[: 3 * len(rows)].reshape(-1, 3, 3)
    path.write_bytes(bytes(80) + struct.pack("<I", len(rows)) + rows.tobytes())
    return path


@pytest.mark.parametrize("count", [3000, 40_000])
def test_a_round_body_is_replaced_by_one_of_few_corners_that_contains_it_and_is_barely_larger(count: int):
    points = turned(ball(count) * SIZE)
    corners = simple_corners(points)
    points = points[:5000]
    assert len(corners) <= mesh.MOST_CORNERS
    assert outside(corners, points) < 1e-9
    assert outside(points, corners) < 0.05 * SIZE.max()
    assert ConvexHull(corners).volume < 1.1 * 4 / 3 * np.pi * SIZE.prod()


def test_a_body_of_flat_faces_keeps_its_corners_however_finely_it_is_meshed():
    rng = np.random.default_rng(2)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * SIZE / 2
    weights = rng.dirichlet(np.ones(8), 40_000)
    points = turned(np.vstack([corners, weights @ corners]))
    found = simple_corners(points)
    assert len(found) == 8
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(turned(corners), axis=0), atol=1e-9)


@pytest.mark.parametrize("count", [1000, 30_000])
def test_a_flat_mesh_of_many_vertices_is_inside_a_box(count: int):
    flat = turned(ball(count) * [0.3, 0.2, 0.0])
    found = simple_corners(flat)
    assert len(found) == 8
    middle = flat.mean(axis=0)
    axes = np.linalg.svd(flat - middle, full_matrices=False)[2]
    low, high = ((found - middle) @ axes.T).min(axis=0), ((found - middle) @ axes.T).max(axis=0)
    along = (flat - middle) @ axes.T
    assert (along > low - 1e-9).all()
    assert (along < high + 1e-9).all()


def test_devices_pipes_and_folders_are_no_meshes_and_nothing_waits_for_them(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zero.stl").symlink_to("/dev/zero")
    (tmp_path / "folder.obj").mkdir()
    for name in ("pipe.stl", "zero.stl", "folder.obj"):
        with pytest.raises(MeshError, match=f"{name} is not used: it is a (folder|device, pipe or socket)"):
            mesh_corners(tmp_path / name)


def test_a_mesh_beyond_the_bounds_is_named_with_the_bound(tmp_path: Path, monkeypatch):
    path = tmp_path / "big.stl"
    with path.open("wb") as stream:
        stream.truncate(mesh.MOST_BYTES + 1)
    with pytest.raises(MeshError, match=r"big\.stl is not used: it has 50 MB, the limit is 50 MB"):
        read_vertices(path)
    monkeypatch.setattr(mesh, "MOST_VERTICES", 10)
    monkeypatch.setattr(mesh, "_AT_ONCE", 5)
    (tmp_path / "many.obj").write_text("v 0 1 2\n" * 30)
    with pytest.raises(MeshError, match=r"many\.obj is not used: it has more than 10 vertices"):
        read_vertices(tmp_path / "many.obj")


def test_a_large_text_mesh_takes_little_memory(tmp_path: Path):
    rows = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\nvn 0 0 1\n" for x, y, z in ball(20_000))
    (tmp_path / "a.obj").write_text(rows)
    tracemalloc.start()
    points = read_vertices(tmp_path / "a.obj")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(points) == 20_000
    assert peak < 20 * len(rows)


def test_a_mesh_is_read_once_until_it_changes(tmp_path: Path, monkeypatch):
    path = stl(tmp_path / "a.stl", ball(300))
    reads: list[Path] = []
    read = mesh.read_vertices
    monkeypatch.setattr(mesh, "read_vertices", lambda each: reads.append(each) or read(each))
    first = mesh_corners(path)
    assert mesh_corners(path) is first
    stl(path, 2 * ball(300))
    os.utime(path, ns=(1, 1))
    assert np.abs(mesh_corners(path)).max() > 1.5
    assert len(reads) == 2


@pytest.mark.slow
def test_five_megabytes_are_read_and_simplified_in_three_seconds_of_processor_time(tmp_path: Path):
    path = stl(tmp_path / "a.stl", ball(300_000) * SIZE)
    before = os.times()
    mesh_corners(path)
    after = os.times()
    assert path.stat().st_size > 4.9e6
    assert after.user + after.system - before.user - before.system < 3.0
