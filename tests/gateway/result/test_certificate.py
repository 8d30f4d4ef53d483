"""The load certificate: valid by the schema, the numbers of the result, and what it says where nothing is certified."""

import copy
import json
import math
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from gateway.result.certificate import certificate
from gateway.result.dcc import certificate_xml, software_sha256
from gateway.result.result import from_json, to_json
from tests.support.pages.result import full_result
from tests.support.rigs.command_line import run

SCHEMA = Path(__file__).parents[2] / "support" / "certificate" / "dcc.xsd"
NAMES = {"d": "https://ptb.de/dcc", "s": "https://ptb.de/si"}
SOURCE = "measured 2026-03-02 with load disc of 20.004 kg, standard deviation 0.4 %"
CALIBRATED = {"value": 1.021, "unit": "-", "source": SOURCE}
REFUSED = {"label": "b", "mass_kg": None, "refused": "rows 9 and 10 have the wrong <sign> & value"}


@pytest.fixture(scope="module")
def schema():
    return etree.XMLSchema(etree.parse(SCHEMA))


@pytest.fixture
def plain():
    return copy.deepcopy(full_result())


def as_result(plain):
    return from_json(json.dumps({key: value for key, value in plain.items() if key != "sha256"}))


def tree_of(result, label=None):
    return etree.fromstring(certificate_xml(result, label, date(2026, 4, 5)).encode())


def content(tree, path):
    return [" ".join(node.itertext()).strip() for node in tree.findall(path, NAMES)]


def changed(plain, case):
    """The result of a case that a certificate has to carry."""
    if case == "unidentifiable centre":
        load = plain["loads"][0]
        load["com_m"] = load["com_flange_m"] = [0.01, None, 0.1]
        load["com_std_m"], load["unidentifiable"] = [0.001, None, 0.01], ["com_y_m"]
        plain["data"]["flange"] = {}
    elif case == "one refused":
        plain["loads"] = [plain["loads"][0], REFUSED]
    elif case == "all refused":
        plain["loads"] = [REFUSED]
    elif case == "no more than loads":
        plain = {"schema": 1, "robot": "r", "loads": [plain["loads"][0] | {"label": " \u202e; <a>"}]}
    elif case == "inertia":
        plain["loads"][0] |= {"inertia_kg_m2": [0.5, 0.6, 0.7, 0, 0.01, None], "inertia_std_kg_m2": [0.1] * 5 + [None]}
    elif case == "temperatures":
        plain["data"]["temperature_c"] = [[31.5, 38.25], [None, None], *[[20.0, 21.0]] * 4]
    elif case == "calibrated":
        plain["provenance"]["J2"]["torque_scale"] = CALIBRATED
    return plain


PARTIAL = ["unidentifiable centre", "one refused", "all refused", "no more than loads"]
CASES = ["two loads", *PARTIAL, "inertia", "calibrated", "temperatures"]


@pytest.mark.parametrize("case", CASES)
def test_every_certificate_is_valid_by_the_schema(schema, plain, case):
    tree = tree_of(as_result(changed(plain, case)))
    assert schema.validate(tree), schema.error_log


def test_the_schema_of_the_tests_refuses_what_is_no_certificate(schema, plain):
    text = certificate_xml(as_result(plain), None, date(2026, 4, 5))
    for right, wrong in (("3.3.0", "3.2.0"), ("si:unit>", "si:units>"), (r"\kilogram", "kg"), (">ZZ<", ">Zz<")):
        assert right in text
        assert not schema.validate(etree.fromstring(text.replace(right, wrong).encode())), wrong


def test_values_and_uncertainties_are_those_of_the_result(plain):
    plain["loads"][0]["com_flange_m"] = None
    result = as_result(plain)
    tree = tree_of(result, "tool")
    load = result.loads[0]
    reals = tree.findall(".//d:quantity[@refType='basic_measuredValue']/s:real", NAMES)
    assert [float(real.findtext("s:value", None, NAMES)) for real in reals] == [load.mass_kg, *load.com_m]
    expanded = [float(real.findtext(".//s:valueExpandedMU", None, NAMES)) for real in reals]
    assert expanded == pytest.approx([1.96 * std for std in (load.mass_std_kg, *load.com_std_m)], rel=1e-12)
    assert {real.findtext(".//s:coverageFactor", None, NAMES) for real in reals} == {"1.96"}
    assert {real.findtext(".//s:coverageProbability", None, NAMES) for real in reals} == {"0.95"}
    assert [real.findtext("s:unit", None, NAMES) for real in reals] == [r"\kilogram", *[r"\metre"] * 3]


def test_expanded_uncertainty_is_that_of_a_monte_carlo_of_the_budget(plain):
    plain["loads"][0]["budget"] = {"constants": 0.6, "links": 0.15, "friction": 0.05, "drift": 0.1, "noise": 0.1}
    (load, _) = certificate(as_result(plain)).loads
    rng = np.random.default_rng(5)
    # JCGM 101: draw every source, form the quantity, take the shortest interval that holds 95 % of the draws
    drawn = sum(line.std_kg * rng.standard_normal(200_000) for line in load.budget)
    low, high = np.quantile(drawn, [0.025, 0.975])
    assert load.quantities[0].expanded == pytest.approx((high - low) / 2, rel=0.05)
    assert {line.source: line.evaluation for line in load.budget}["noise"] == "A"
    assert {line.evaluation for line in load.budget if line.source != "noise"} == {"B"}


def test_stated_constants_are_not_traceable_and_measured_ones_name_the_weighed_mass(plain):
    without = tree_of(as_result(plain))
    assert content(without, ".//d:statement/d:name") == ["NOT TRACEABLE"]
    assert content(without, ".//d:statement/d:traceable") == ["false"]
    traced = tree_of(as_result(changed(plain, "calibrated")))
    (statement,) = content(traced, ".//d:statement/d:declaration")
    assert "J2: measured 2026-03-02 with weighed mass disc of 20.004 kg" in statement
    assert content(traced, ".//d:statement/d:traceable") == ["true"]
    axes = [joint for joint in plain["provenance"] if joint.startswith("J") and joint != "J2"]
    assert f"cell file: {', '.join(axes)}." in statement


def test_a_refused_load_has_its_reason_and_no_value(plain):
    tree = tree_of(as_result(changed(plain, "one refused")))
    assert any(REFUSED["refused"] in text for text in content(tree, ".//d:statement/d:declaration"))
    refused = tree.findall(".//d:measurementResult", NAMES)[1]
    assert not refused.findall(".//d:results//s:real", NAMES)


def test_what_is_not_determined_has_no_number(plain):
    tree = tree_of(as_result(changed(plain, "unidentifiable centre")))
    first = tree.find(".//d:measurementResult", NAMES)
    assert [float(value) for value in content(first, ".//d:results//d:quantity[@refType]//s:value")] == [
        25.03,
        0.01,
        0.1,
    ]
    assert content(first, ".//d:noQuantity") == ["the data do not determine it"]


def test_drives_and_checksums_are_named(plain):
    result = as_result(plain)
    text = certificate_xml(result, None, date(2026, 4, 5))
    assert software_sha256() in text
    for drive in result.data.drives:
        assert f"drive of J{drive.joint}" in text
    for source in result.data.sources:
        assert source.sha256 is None or f"sha256 {source.sha256}" in text


def test_the_software_checksum_changes_with_a_file(monkeypatch, tmp_path):
    (tmp_path / "a").mkdir()
    file = tmp_path / "a" / "x.py"
    file.write_text("1")
    monkeypatch.setattr("gateway.result.dcc.files", lambda _package: tmp_path)
    first = software_sha256()
    file.write_text("2")
    assert software_sha256() != first
    file.write_text("1")
    assert software_sha256() == first
    (tmp_path / "a" / "__pycache__").mkdir()
    (tmp_path / "a" / "__pycache__" / "x.pyc").write_text("3")
    assert software_sha256() == first


def written(tmp_path, plain):
    path = tmp_path / "result.json"
    path.write_text(to_json(as_result(plain)))
    return path


def test_export_writes_the_certificate_and_says_that_it_is_not_traceable(tmp_path, plain, schema):
    out = tmp_path / "c.xml"
    done = run("export", written(tmp_path, plain), "--format", "dcc", "-o", out)
    assert done.exit_code == 0, done.output
    assert "NOT TRACEABLE" in done.output
    assert schema.validate(etree.parse(out))
    assert len(etree.parse(out).findall(".//d:measurementResult", NAMES)) == 2


def test_export_of_a_refused_load_writes_the_refusal_and_fails(tmp_path, plain, schema):
    out = tmp_path / "c.xml"
    done = run("export", written(tmp_path, changed(plain, "all refused")), "--format", "dcc", "-o", out)
    assert done.exit_code == 7
    assert "rows 9 and 10" in done.output
    assert schema.validate(etree.parse(out))


@pytest.mark.parametrize(("loads", "words", "code"), [([], [], 6), (None, ["--load", "absent"], 3)])
def test_export_without_a_load_to_certify_says_so(tmp_path, plain, loads, words, code):
    if loads is not None:
        plain["loads"] = loads
    done = run("export", written(tmp_path, plain), "--format", "dcc", "-o", tmp_path / "c.xml", *words)
    assert done.exit_code == code, done.output
    assert not (tmp_path / "c.xml").exists()


def test_the_range_of_the_motor_temperatures_is_stated(plain):
    tree = tree_of(as_result(changed(plain, "temperatures")), "tool")
    names = content(tree, ".//d:influenceCondition/d:name")
    assert [name for name in names if "motor" in name] == [
        f"temperature of motor or drive J{i}" for i in (1, 3, 4, 5, 6)
    ]
    condition = tree.find(".//d:influenceCondition", NAMES)
    assert content(condition, ".//s:value") == ["31.5", "38.25"]


def test_a_mass_without_an_uncertainty_is_not_certified(plain):
    plain["loads"][0]["mass_std_kg"] = None
    (load, _) = certificate(as_result(plain)).loads
    assert math.isnan(load.quantities[0].value)
