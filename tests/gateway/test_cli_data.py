"""estimate and diagnose from the command line: measured_data and measured data, bad input, exit codes."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from gateway.model.regressor import gravity_regressor
from gateway.model.robot import robot_from_urdf
from tests.support.rigs.command_line import run

URDF = Path(__file__).parents[2] / "examples" / "small" / "robot.urdf"
COEFFICIENT = ("--method", "coefficient", "--axis", "2", "--lever", "x_k2_m")
GEAR = ("--gear-ratio", "210", "--gear-efficiency", "0.8", "--rated-torque", "23.875")
TOOL = (4.0, 0.02, -0.01, 0.12)


@pytest.fixture
def table(tmp_path):
    """Write a rest table of the small arm from its closed-form gravity, bare and with a tool."""
    robot = robot_from_urdf(URDF.read_text(encoding="utf-8"), str(URDF))
    rng = np.random.default_rng(4)
    poses = rng.uniform(-1.2, 1.2, (8, 6))

    def write(name="rows.csv", poses=poses, loads=("none", "tool"), change=lambda line: line, rng=rng):
        bodies = np.concatenate([robot.mass_kg[:, None], robot.mass_kg[:, None] * robot.com_m], axis=1)
        mass, *com = TOOL
        names = [pattern.format(joint) for pattern in ("q{}_rad", "dir{}", "tau{}_nm") for joint in range(1, 7)]
        lines = [",".join(["load", "pose", *names])]
        for load in loads:
            carried = bodies.copy()
            if load.strip() != "none":
                carried[5] += mass * np.array([1.0, *com])
            torque = gravity_regressor(robot, poses) @ carried.ravel()
            for number, (q, tau) in enumerate(zip(poses, torque, strict=True), start=1):
                for side in (-1, 1):
                    noisy = tau + side * np.array([4.0, 4.0, 2.0, 0.6, 0.5, 0.3]) + rng.normal(0, 0.05, 6)
                    values = (*q.tolist(), *[side] * 6, *noisy.tolist())
                    lines.append(",".join([load, str(number), *map(repr, values)]))
        path = tmp_path / name
        path.write_text("\n".join(change(line) for line in lines) + "\n", encoding="utf-8")
        return path

    return write


def complains(done, code, *says):
    assert done.exit_code == code, done.output
    assert "Traceback" not in done.output
    for text in says:
        assert text in done.stderr, done.stderr


def test_a_load_is_estimated_by_every_method(table):
    path = table()
    for method in ("joint", "difference", "posture"):
        done = run("estimate", path, "--robot", URDF, "--method", method, "--json", "-")
        assert done.exit_code == 0, done.output
        (load,) = json.loads(done.stdout)["loads"]
        assert abs(load["mass_kg"] - TOOL[0]) < min(2.0 * load["mass_std_kg"], 0.15)
        assert load["com_m"] == pytest.approx(TOOL[1:], abs=0.005)


SMALL = URDF.parent / "cell.toml"


def test_a_load_beyond_the_arm_is_refused_and_not_exported(table, tmp_path):
    def in_millinewtonmetres(line):
        words = line.split(",")
        if words[0] == "tool":
            words[-6:] = [repr(1000 * float(word)) for word in words[-6:]]
        return ",".join(words)

    out = tmp_path / "out.json"
    done = run("estimate", table(change=in_millinewtonmetres), "--cell", SMALL, "--json", out)
    complains(done, 7)
    (load,) = json.loads(out.read_text())["loads"]
    assert load["mass_kg"] is None
    assert "torque in mNm?" in load["refused"]
    assert json.loads(out.read_text())["after"]["loads"] == [load]
    complains(run("export", out, "--format", "kuka"), 6, "torque in mNm?")


def test_the_frame_of_a_known_load_is_named_or_reported(table):
    path = table(loads=("none", "tool", "other"))
    cosine, sine = np.cos(np.pi / 6), np.sin(np.pi / 6)  # of the cell's flange: 0.02 m along z, turned by 30 degrees
    x, y, z = TOOL[1:]
    flange = ",".join(map(repr, (float(cosine * x + sine * y), float(cosine * y - sine * x), z - 0.02)))
    found = []
    for known in ("0.02,-0.01,0.12", "link_6=0.02,-0.01,0.12", f"flange={flange}"):
        done = run("estimate", path, "--cell", SMALL, "--known", f"tool=4,{known}", "--json", "-")
        found.append(json.loads(done.stdout))
    masses = [result["loads"][0]["mass_kg"] for result in found]
    assert masses == pytest.approx([masses[0]] * 3, rel=1e-9)
    has_warning = ["no frame was named" in json.dumps(result["findings"]) for result in found]
    assert has_warning == [True, False, False]


def test_json_on_stdout_is_json_alone_and_the_table_is_on_stderr(table):
    done = run("estimate", table(), "--robot", URDF, "--json", "-")
    body = json.loads(done.stdout)
    assert body["schema"] == 1
    assert {"rows", "data", "provenance"} <= set(body)
    assert "mass [kg]" in done.stderr
    quiet = run("estimate", table(), "--robot", URDF, "--json", "-", "-q")
    assert quiet.stderr == ""


def test_a_report_of_an_estimate_needs_the_json_alone(table, tmp_path):
    out, page = tmp_path / "out.json", tmp_path / "report.html"
    assert run("estimate", table(), "--robot", URDF, "--json", out).exit_code == 0
    assert run("report", out, "-o", page).exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert text.count('aria-label="The arm in') == 8
    assert "Residual per axis and pose" in text


def test_a_stored_bare_identification_serves_later_loads(table, tmp_path):
    bare = tmp_path / "bare.json"
    done = run("estimate", table("bare.csv", loads=("none",)), "--robot", URDF, "--inertials", "ignore", "--json", bare)
    assert done.exit_code == 0, done.output
    done = run(
        "estimate", table("tool.csv", loads=("tool",)), "--robot", URDF, "--inertials", "ignore", "--bare", bare,
        "--method", "posture", "--json", "-",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["loads"][0]["mass_kg"] == pytest.approx(TOOL[0], abs=0.1)


def torques(line, change):
    """Replace the six torques at the end of a line of the table; `change` maps the six numbers."""
    if line.startswith("load,"):
        return line
    *others, t1, t2, t3, t4, t5, t6 = line.split(",")
    return ",".join([*others, *(repr(each) for each in change([*map(float, (t1, t2, t3, t4, t5, t6))]))])


@pytest.mark.parametrize("command", ["estimate", "diagnose"])
def test_a_torque_that_does_not_scatter_is_named_and_left_out(table, command):
    """J6 reports zero in all samples: no sign of exchanged cables, no centre without uncertainty."""
    path = table(change=lambda line: torques(line, lambda tau: [*tau[:5], 0.0]))
    done = run(command, path, "--robot", URDF, "--json", "-")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    (named,) = [each for each in result["findings"] if each.get("check") == "torque_without_scatter"]
    assert named["where"] == "J6"
    assert not any("swapped" in each["name"] for each in result.get("effects", []))
    (load,) = result["loads"]
    assert load["mass_kg"] == pytest.approx(TOOL[0], abs=2.5 * load["mass_std_kg"])
    assert all(std is None or std > 1e-6 for std in load["com_std_m"])


@pytest.mark.parametrize("command", ["estimate", "diagnose"])
@pytest.mark.parametrize(
    ("change", "says"),
    [(lambda tau: [0.0] * 6, "nothing was measured"), (lambda tau: [round(each, 12) for each in tau], "computed")],
    ids=["zeros", "computed"],
)
def test_torques_that_were_not_measured_are_refused(table, command, change, says):
    """Computed torques: the same from both approach directions, as no axis with friction has them."""

    class Still:
        def normal(self, *_):
            return np.array([4.0, 4.0, 2.0, 0.6, 0.5, 0.3])

    sides = iter(range(10**6))

    def without_friction(line):
        # the writer adds side * band and the noise; here both are taken off
        band = np.array([4.0, 4.0, 2.0, 0.6, 0.5, 0.3])
        side = -1 if next(sides) % 2 else 1
        return torques(line, lambda tau: change((np.array(tau) - (1 + side) * band).tolist()))

    complains(run(command, table(change=without_friction, rng=Still()), "--robot", URDF), 6, says)


def test_the_constant_of_a_table_of_currents_is_used_whatever_the_drive_reports(table):
    """5 % of the data sheet instead of the 3 % of a torque that the drives report; J1 carries no weight."""
    torque = json.loads(run("estimate", table(), "--cell", SMALL, "--json", "-").stdout)
    as_current = table("currents.csv", change=lambda line: line.replace("tau", "i").replace("_nm", "_a"))
    current = json.loads(run("estimate", as_current, "--cell", SMALL, "--json", "-").stdout)
    assert "not used" in torque["provenance"]["J2"]["torque_constant"]["source"]
    assert "not used" not in current["provenance"]["J2"]["torque_constant"]["source"]
    for result, std in ((torque, 0.03), (current, 0.05)):
        assert result["nuisance"]["gain"]["std"][0] == pytest.approx(std, rel=0.1)


def test_what_is_missing_is_asked_for(table):
    path = table()
    complains(run("estimate", path, "--robot", "nowhere.urdf"), 3, "nowhere.urdf")
    complains(run("estimate", path, "--robot", URDF, "--known", "tool=heavy"), 3, "LABEL=MASS,X,Y,Z")
    complains(run("estimate", path, "--robot", URDF, "--inertials", "perhaps"), 3, "perhaps")
    complains(run("estimate", path, "--robot", URDF, "--bare", path), 3, "rows.csv")
    complains(run("estimate", path, "--method", "coefficient"), 2, "--lever")
    lever = table("lever.csv", change=lambda line: f"{line},{'x_k2_m' if 'load' in line else 0.5}")
    complains(run("estimate", lever, *COEFFICIENT, "--cell", SMALL, "--gear-ratio", 0), 3, "--gear-ratio")


def test_diagnose_finds_nothing_missing_in_what_the_model_made(table):
    done = run("diagnose", table(), "--robot", URDF, "--json", "-")
    assert done.exit_code == 0, done.output
    body = json.loads(done.stdout)
    assert body["verdict"] == "none_needed"
    assert body["effects"] == []


@pytest.mark.parametrize(
    "options", [("estimate",), ("diagnose", "--only", "axes_swapped")], ids=["estimate", "diagnose"]
)
def test_labels_that_differ_by_case_are_reported_with_their_rows(table, options):
    name, *more = options
    path = table(loads=("none", "tool", "Tool"))
    done = run(name, path, "--robot", URDF, *more, "--json", "-")
    assert done.exit_code == 0, done.output
    (finding,) = [each for each in json.loads(done.stdout)["findings"] if each["where"] == "load labels"]
    assert finding["severity"] == "warn"
    assert f"'tool' (16 rows, the first is {path}:18)" in finding["what"]
    assert f"'Tool' (16 rows, the first is {path}:34)" in finding["what"]


@pytest.mark.data
def test_the_measured_data_load_of_21_kg_is_recomputed_and_the_one_of_70_kg_refused(measured_data):
    done = run("estimate", measured_data / "qh165" / "table2.csv", *COEFFICIENT, *GEAR, "--json", "-")
    assert done.exit_code == 7
    a, b = json.loads(done.stdout)["loads"]
    assert all(20.9 <= mass <= 21.4 for mass in a["per_pose_mass_kg"].values())
    assert len(a["per_pose_mass_kg"]) == 10
    assert a["mass_kg"] == pytest.approx(21.06, abs=0.01)
    assert (a["inertia_kg_m2"], a["unidentifiable"]) == (None, ["com_x_m", "com_y_m", "com_z_m", "inertia_kg_m2"])
    assert b["mass_kg"] is None
    assert "rated" in b["refused"]
    assert "9, 10" in b["refused"]
    assert "load b" in done.stderr


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("command", ["estimate", "diagnose"])
@pytest.mark.parametrize("name", ["kr300", "tx40", "ur10", "qh165"])
def test_every_measured_table_ends_with_an_exit_code_of_the_reference(measured_data, name, command):
    folder = measured_data / name
    robot = ["--robot", folder / "robot.urdf"] if (folder / "robot.urdf").exists() else []
    for path in sorted(folder.glob("*.csv")):
        done = run(command, path, *robot)
        assert done.exit_code in {0, 3, 6, 7}, done.output
        assert "Traceback" not in done.output


@pytest.mark.slow
@pytest.mark.parametrize("command", ["estimate", "diagnose"])
@pytest.mark.parametrize("seed", range(3))
def test_a_table_with_outliers_and_single_approaches_ends_without_a_traceback(table, seed, command):
    """Torques that are pushed by 60 Nm at random, a third of the approaches missing, labels that differ by case."""
    rng = np.random.default_rng(seed)

    def change(line):
        cells = line.split(",")
        if cells[0] == "load":
            return line
        if rng.random() < 0.05:
            joint = 14 + int(rng.integers(6))
            cells[joint] = repr(float(cells[joint]) + 60.0)
        cells[0] = "Tool" if cells[0] == "tool" and rng.random() < 0.5 else cells[0]
        return ",".join(cells) if rng.random() > 1 / 3 else None

    path = table(poses=rng.uniform(-1.2, 1.2, (12, 6)), rng=rng)
    lines = map(change, path.read_text(encoding="utf-8").splitlines())
    path.write_text("\n".join(line for line in lines if line) + "\n", encoding="utf-8")
    done = run(command, path, "--robot", URDF)
    assert done.exit_code in {0, 3, 6, 7}, done.output
    assert "Traceback" not in done.output


@pytest.mark.slow
@pytest.mark.parametrize("command", ["estimate", "diagnose"])
def test_what_is_to_be_measured_next_keeps_the_limits_of_the_cell(table, tmp_path, command):
    """The robot could go further: joint 1 may turn from 0.5 to 0.9 rad here, and was at other angles before."""
    text = (URDF.parent / "cell.toml").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith(("home_rad", "loading_rad"))]
    cell = tmp_path / "cell.toml"
    cell.write_text("\n".join(kept).replace("[-2.8, 2.8]", "[0.5, 0.9]", 1), encoding="utf-8")
    (tmp_path / "robot.urdf").write_text(URDF.read_text(encoding="utf-8"), encoding="utf-8")
    few = table(poses=np.random.default_rng(4).uniform(-1.2, 1.2, (3, 6)))
    asked = {}
    for name, model in {"cell": ("--cell", cell), "robot": ("--robot", URDF)}.items():
        done = run(command, few, *model, "--json", "-")
        poses = [pose for entry in json.loads(done.stdout)["next"] for pose in entry.get("poses_rad", [])]
        assert poses, done.output
        asked[name] = np.array(poses)
    assert ((asked["cell"][:, 0] > 0.5) & (asked["cell"][:, 0] < 0.9)).all()
    assert not ((asked["robot"][:, 0] > 0.5) & (asked["robot"][:, 0] < 0.9)).all()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["estimate", "diagnose"])
def test_a_load_is_accepted_or_not_or_undecided(table, tmp_path, command):
    """The tool weighs 4 kg; exact constants and links, so that the interval is some grams."""
    path, page = table(), tmp_path / "accept.xml"
    words = [
        command,
        path,
        "--robot",
        URDF,
        "--inertials",
        "exact",
        "--torque-gain",
        "exact",
        "--junit",
        page,
    ]
    for expected, code, outcome in (("4.0,0.3", 0, "pass"), ("4.5,0.3", 7, "fail"), ("3.993,0.005", 7, "cannot tell")):
        done = run(*words, "--expect", f"tool={expected}", "--json", "-")
        assert done.exit_code == code, done.output
        (row,) = json.loads(done.stdout)["acceptance"]
        assert (row["outcome"], row["load"], row["unit"]) == (outcome, "tool", "kg")
        assert outcome in done.stderr
        failures = ElementTree.parse(page).getroot().findall(".//failure")
        assert [failure.get("type") for failure in failures] == ([outcome] if code else [])


def test_what_is_expected_has_to_be_in_the_data(table):
    path = table()
    words = ("estimate", path, "--robot", URDF, "--expect")
    complains(run(*words, "toll=4,1"), 3, "toll", "tool", str(path))
    complains(run(*words, "tool=4"), 3, "LABEL=MASS,TOLERANCE")
    complains(run(*words, "tool=4,1", "--known", "tool=4,0,0,0"), 3, "hold: none")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "seed", "says", "status"),
    [
        ("estimate", 1, "kg: no load detected. Is it mounted?", "open"),
        ("diagnose", 1, "kg: no load detected. Is it mounted?", "open"),
        ("diagnose", 5, "kg: no load detected. Is it mounted?", "open"),
        ("estimate", 4, "kg, which no body has", "bad"),
        ("diagnose", 4, "kg, which no body has", "bad"),
    ],
)
def test_a_load_that_was_not_mounted_is_asked_for(table, tmp_path, command, seed, says, status):
    """Rows of the unloaded arm under the label of a load; noise that leaves the interval about 0, or below it."""
    out, page = tmp_path / "out.json", tmp_path / "page.html"
    path = table(
        "bare.csv",
        loads=("none", "none "),
        change=lambda line: line.replace("none ,", "tool,"),
        rng=np.random.default_rng(seed),
    )
    done = run(command, path, "--robot", URDF, "--json", out)
    assert done.exit_code == 7, done.output
    assert says in done.stderr
    assert run("report", out, "-o", page).exit_code == 0
    assert f'class="verdict {status}"' in page.read_text(encoding="utf-8")


def test_a_joint_beyond_the_data_is_refused_with_the_tip_to_type_and_fixed_with_it(table, tmp_path):
    text = URDF.read_text(encoding="utf-8")
    more = (
        '<link name="l7"/><joint name="j7" type="revolute"><parent link="link_6"/><child link="l7"/>'
        '<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="5" velocity="1"/></joint></robot>'
    )
    seven, path = tmp_path / "seven.urdf", table()
    seven.write_text(text.replace("</robot>", more), encoding="utf-8")
    for command in ("estimate", "diagnose"):
        complains(
            run(command, path, "--robot", seven), 3, "data have 6 axes", "where j7 is not an axis", "--tip link_6"
        )
    done = run("estimate", path, "--robot", seven, "--tip", "link_6", "--json", "-")
    assert done.exit_code == 0, done.output
    assert "seven.urdf: joints taken as fixed at zero: 'j7' (revolute)" in done.stderr
    plain = run("estimate", path, "--robot", URDF, "--json", "-")
    assert json.loads(done.stdout)["loads"] == json.loads(plain.stdout)["loads"]


def test_the_range_of_the_motor_temperatures_is_in_the_result(table, tmp_path):
    def with_temperature(line):
        if line.startswith("load,"):
            return f"{line},temp2_c"
        warm = 30.0 + 0.5 * int(line.split(",")[1])
        return f"{line},{warm}"

    out = tmp_path / "out.json"
    assert run("estimate", table(change=with_temperature), "--robot", URDF, "--json", out).exit_code == 0
    ranges = json.loads(out.read_text())["data"]["temperature_c"]
    assert ranges[1] == [30.5, 34.0]
    assert [pair for pair in ranges if pair != [30.5, 34.0]] == [[None, None]] * 5
