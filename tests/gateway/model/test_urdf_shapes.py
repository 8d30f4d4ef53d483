"""Shapes of a link as a URDF writes them: sizes, scales, and what is refused."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from gateway.model.urdf_shapes import Box, Cylinder, Mesh, Sphere, Unknown, shapes_of


def shapes(geometry: str) -> list[object]:
    text = f'<link name="a"><collision><geometry>{geometry}</geometry></collision></link>'
    return [shape for _, shape in shapes_of(ET.fromstring(text), "a", "r.urdf")]


@pytest.mark.parametrize(
    ("geometry", "shape"),
    [
        ('<sphere radius="0.4"/>', Sphere(0.4)),
        ('<cylinder radius="0.1" length="0.7"/>', Cylinder(0.1, 0.7, False)),
        ('<capsule radius="0.1" length="0.7"/>', Cylinder(0.1, 0.7, True)),
        ('<box size="0.1 0.2 0.3"/>', Box((0.1, 0.2, 0.3))),
        ('<mesh filename="a.stl"/>', Mesh("a.stl", (1.0, 1.0, 1.0))),
        ('<mesh filename="a.stl" scale="0.001 0.001 0.002"/>', Mesh("a.stl", (0.001, 0.001, 0.002))),
        ("<mesh/>", Unknown("<mesh>")),
        ("<heightmap/>", Unknown("<heightmap>")),
    ],
)
def test_a_shape_is_read_with_its_size(geometry: str, shape: object):
    assert shapes(geometry) == [shape]


@pytest.mark.parametrize(
    "geometry",
    [
        '<sphere radius="0"/>',
        '<sphere radius="-0.1"/>',
        "<sphere/>",
        '<cylinder radius="0.1" length="0"/>',
        '<cylinder radius="0" length="0.1"/>',
        '<cylinder radius="0.1" length="long"/>',
        '<box size="0.1 0 0.3"/>',
        '<box size="0.1 0.2 -0.3"/>',
        '<box size="0.1 0.2"/>',
        '<mesh filename="a.stl" scale="1"/>',
    ],
)
def test_a_shape_without_a_usable_size_is_unknown_and_named_as_it_is_written(geometry: str):
    (shape,) = shapes(geometry)
    assert isinstance(shape, Unknown)
    tag, _, value = geometry.strip("<>/").partition(" ")
    assert shape.what.startswith(f"<{tag}>")
    assert all(part.split('"')[0] in shape.what for part in value.split('="')[1:])


def test_a_collision_without_a_geometry_has_no_shape():
    assert list(shapes_of(ET.fromstring('<link name="a"><collision/></link>'), "a", "r.urdf")) == []
