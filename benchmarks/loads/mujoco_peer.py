"""System identification of MuJoCo in the benchmark: `mujoco.sysid` with torques by `mj_inverse` in its rollout hook.

Two models share one set of parameters: the arm with the unloaded run, and the arm with a body on its last link with
the loaded run. Links, load, friction, damping and armature are free within bounds; `mujoco.sysid` has no priors. The
axes are weighted by the residual of a first fit. A simulation forward in time would leave the measured motion within
seconds, and has no motion at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import mujoco  # pyright: ignore[reportMissingImports]
import numpy as np
from mujoco import sysid  # pyright: ignore[reportMissingImports]
from mujoco.sysid._src.model_modifier import pi_from_theta  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

from benchmarks.loads.bodies import Identified, identified
from benchmarks.loads.runs import BARE, TOOL, Run, quiet, runs_of, thinned
from benchmarks.naming.cells import Cell

Floats = NDArray[np.float64]

#: Start value of the load: mass over that of the last link, distance of its centre [m].
START_MASS, START_OUT_M = 1.0, 0.05
MASS_FACTORS = np.array([0.01, 100.0])
LINK_FACTORS = np.array([0.5, 2.0])
OFFSETS_M = np.array([-1.0, 1.0])
#: Of `sysid.optimize`; its default optimizer stops at once where combinations of links have no effect.
OPTIONS: Final = {"optimizer": "scipy", "x_scale": "jac", "max_iters": 50, "ftol": 1e-4}


def identify(cell: Cell, moving: bool) -> Identified:
    """Fit both runs together: first with equal weights of the axes, then with their residuals as weights."""
    with quiet():
        return _identify(cell, moving)


def _identify(cell: Cell, moving: bool) -> Identified:
    runs = runs_of(cell, moving)
    if moving:
        runs = {label: thinned(run) for label, run in runs.items()}
    specs = {BARE: _spec(cell.urdf, False), TOOL: _spec(cell.urdf, True)}
    names = [joint.name for joint in specs[BARE].joints]
    parameters = _parameters(specs[TOOL], names, moving)
    weights = np.ones(len(names))
    residual, jacobian = np.zeros(0), np.zeros((0, 0))
    for _ in range(2):
        function = _residual_function(runs, specs, weights)
        parameters, result = sysid.optimize(parameters, function, verbose=False, **OPTIONS)
        parts = function(result.x, parameters)[0]
        residual, jacobian = np.concatenate(parts), result.jac
        by_axis = np.concatenate([part.reshape(-1, len(names)) for part in parts]) / weights
        weights = 1.0 / np.sqrt((by_axis**2).mean(axis=0))
    return _answer(parameters, _covariance(residual, jacobian), names, moving)


def _covariance(residual: Floats, jacobian: Floats) -> Floats:
    """Return the covariance of `sysid.calculate_intervals`, with a pseudo-inverse.

    Combinations of links have no effect on any torque. The function's own inverse then gives NaN and infinity.
    """
    variance = residual @ residual / (len(residual) - jacobian.shape[1])
    return variance * np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)


def _spec(urdf: str, loaded: bool) -> Any:
    """Model of the arm with a torque sensor on every joint; no contacts and no limits."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.compiler.fusestatic = False  # a load is a body without a joint
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    spec.option.timestep = 1e-4
    for joint in spec.joints:
        joint.solref_friction = [2e-4, 1.0]
        spec.add_sensor(
            name=joint.name,
            type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    if loaded:
        last = spec.bodies[-1]
        mass = START_MASS * float(last.mass)
        size = mass * START_OUT_M**2
        last.add_body(
            name=TOOL, mass=mass, ipos=[0.0, 0.0, START_OUT_M], inertia=[size, size, size], explicitinertial=True
        )
    return spec


def _parameters(spec: Any, joints: Sequence[str], moving: bool) -> Any:
    """Load and links; in motion with inertia, friction, damping and armature."""
    model, out = spec.copy().compile(), sysid.ParameterDict()
    kind = sysid.InertiaType.Pseudo if moving else sysid.InertiaType.MassIpos
    bodies = [body.name for body in spec.bodies if body.joints or body.name == TOOL]
    for name in bodies:
        own = name == TOOL
        out.add(
            sysid.body_inertia_param(
                spec.copy(), model, name, kind, mass_bound_mult=MASS_FACTORS if own else LINK_FACTORS,
                ipos_bound_off=OFFSETS_M, stretch_bound_mult=np.array([0.01, 100.0]),
                shear_bound_off=OFFSETS_M, modifier=_body_modifier(name, moving),
            )
        )  # fmt: skip
    scale = {"frictionloss": 1000.0, "damping": 1000.0, "armature": 500.0} if moving else {}
    for quantity, most in scale.items():
        for name in joints:
            out.add(
                sysid.Parameter(f"{name}_{quantity}", 0.001 * most, 0.0, most, modifier=_joint_modifier(name, quantity))
            )
    return out


def _body_modifier(name: str, pseudo: bool) -> Callable[[Any, Any], None]:
    """Write a body of the model, if it has it.

    `sysid.apply_body_inertia` of version 4.0.0 compiles the model for each body, and writes a rotation of NaN with the
    pseudo-inertia, with which the model does not compile.
    """

    def modifier(spec: Any, parameter: Any) -> None:
        body = spec.body(name)
        if body is None:
            return
        values = _body_of_pseudo_inertia(parameter.value) if pseudo else parameter.value
        body.mass, body.ipos = values[0], values[1:4]
        if pseudo:
            body.inertia, body.iquat, body.fullinertia = np.zeros(3), [1.0, 0.0, 0.0, 0.0], values[4:]

    return modifier


def _joint_modifier(joint: str, quantity: str) -> Callable[[Any, Any], None]:
    def modifier(spec: Any, parameter: Any) -> None:
        value = float(parameter.value[0])
        setattr(spec.joint(joint), quantity, [value, 0.0, 0.0] if quantity == "damping" else value)

    return modifier


def _residual_function(runs: Mapping[str, Run], specs: Mapping[str, Any], weights: Floats) -> Any:
    """Residual function of both runs, as `sysid.optimize` takes it."""
    parts = [_residual_of_run(label, run, specs[label], weights) for label, run in runs.items()]

    def both(values: Floats, parameters: Any) -> tuple[list[Floats], list[Any], list[Any]]:
        return [each for part in parts for each in part(values, parameters)[0]], [], []

    return both


def _residual_of_run(label: str, run: Run, spec: Any, weights: Floats) -> Any:
    model = spec.copy().compile()
    times = np.arange(len(run.q), dtype=float)
    control = sysid.TimeSeries(times, np.zeros((len(times), 0)))
    measured = sysid.TimeSeries(times, run.tau, sysid.TimeSeries.compute_all_sensor_mapping(model))
    state = sysid.create_initial_state(model, run.q[0], run.qd[0], np.zeros(0))

    def modify(_parameters: Any, predicted: Any, _measured: Any, *_: Any, **__: Any) -> Any:
        return (run.tau - predicted.data) * weights, predicted, measured

    return sysid.build_residual_fn(
        models_sequences=[sysid.ModelSequences(label, spec, label, state, control, measured)],
        custom_rollout=_inverse_dynamics(run), resample_true=False, n_threads=1, modify_residual=modify,
    )  # fmt: skip


def _inverse_dynamics(run: Run) -> Any:
    """Torques of every model at the measured states of a run, in place of a simulation."""

    def rollout(models: Any, control_signal: Any, initial_states: Any, rollout_signal_mapping: Any, **_: Any) -> Any:
        out = []
        for model, control, state in zip(models, control_signal, initial_states, strict=True):
            data, torque = mujoco.MjData(model), np.empty(run.tau.shape)
            for row in range(len(torque)):
                data.qpos[:], data.qvel[:], data.qacc[:] = run.q[row], run.qd[row], run.qdd[row]
                mujoco.mj_inverse(model, data)
                torque[row] = data.qfrc_inverse
            sensors = sysid.TimeSeries(control.times, torque, rollout_signal_mapping)
            states = sysid.TimeSeries(control.times, np.column_stack([control.times, run.q, run.qd]))
            out.append(sysid.SystemTrajectory(model, control, sensors, state, states))
        return out

    return rollout


def _answer(parameters: Any, covariance: Floats, joints: Sequence[str], moving: bool) -> Identified:
    place, found = 0, parameters[f"{TOOL}_inertia"].value
    for key, parameter in parameters.items():
        if key == f"{TOOL}_inertia":
            break
        place += parameter.size
    part = slice(place, place + len(found))
    names = {"coulomb_nm": "frictionloss", "viscous_nm_s_rad": "damping", "rotor_inertia_kg_m2": "armature"}
    axes = {
        key: tuple(float(parameters[f"{joint}_{name}"].value[0]) for joint in joints)
        for key, name in names.items()
        if moving
    }
    body = _body_of_pseudo_inertia if moving else np.asarray
    return identified(np.asarray(found, dtype=float), covariance[part, part], axes, body)


def _body_of_pseudo_inertia(theta: Floats) -> Floats:
    linear = pi_from_theta(theta)
    mass, centre = linear[0], linear[1:4] / linear[0]
    tensor = linear[4:].reshape(3, 3) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *centre, *tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])
