"""True physics of the simulated arm, unknown to the gateway.

A `Plant` is a complete description of the physics of one arm: its true inertials, gear losses, sensor errors, load on
the flange. Every field is neutral by default, so that a plant without effects is exactly the arm of the URDF with ideal
gears. Effects are functions from one plant to the next (`dataclasses.replace`); the bus simulation and the tables
computed without a bus read the same fields and therefore obey the same physics.

Symbols used in the field descriptions, per joint:

- `q_enc`   joint angle as the motor encoder gives it (ratio and sign already applied, [rad]);
- `q`       true angle of the link;
- `tau`     torque that the gear output transmits to the joint and that the rigid body needs, actuator torque,
            positive in +q, [Nm]: at rest `tau = gravity(q) - passive_torque`;
- `T`       torque behind the gear and before joint friction: `T = tau + friction`;
- `u`       joint-side equivalent of the true motor torque, gear ratio x motor torque, [Nm]: driving (`u` does work)
            `T = eta u`, driven back `T = u / eta`;
- `r`       joint-side equivalent of what the drive reports, [Nm]: what ratio x stored torque constant x reported
            current gives, efficiency not applied.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PassiveTorque = Callable[[Array, float, Array], Array]
ReadingRipple = Callable[[Array, Array], Array]
Drift = Callable[[float], Mapping[str, object]]

GRAVITY_M_S2 = 9.80665
#: Neutral values of the fields with a number per axis.
NEUTRAL = {
    "rotor_inertia_kg_m2": 0.0,
    "zero_offset_rad": 0.0,
    "compliance_rad_nm": 0.0,
    "stiction_nm": 0.0,
    "coulomb_nm": 0.0,
    "viscous_nm_s_rad": 0.0,
    "load_friction": 0.0,
    "creep_rad_s": 0.0,
    "friction_scatter": 0.0,
    "friction_bias_nm": 0.0,
    "gear_efficiency": 1.0,
    "torque_constant_scale": 1.0,
    "current_factor": 1.0,
    "reading_offset_nm": 0.0,
    "torque_sign": 1.0,
    "reading_noise_nm": 0.0,
}


def _gravity() -> Array:
    return np.array([0.0, 0.0, -GRAVITY_M_S2])


@dataclass(frozen=True, slots=True)
class Payload:
    """A rigid body bolted to the last link.

    Attributes
    ----------
    label : name that commands and result files use
    mass_kg : mass [kg]; 0 is an empty flange
    com_m : array of shape (3,), centre of gravity in the frame of the last link [m]
    inertia_kg_m2 : array of shape (3, 3), about the centre of gravity, axes of the last link [kg m2]
    """

    label: str = "none"
    mass_kg: float = 0.0
    com_m: Array = field(default_factory=lambda: np.zeros(3))
    inertia_kg_m2: Array = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Plant:
    """True physics of one arm of N axes; `nominal_plant` makes one that is neutral in all that is not named.

    Rigid body
    ----------
    link_mass_kg : (N,) true mass of each link [kg]; no default
    link_com_m : (N, 3) true centre of gravity in each link's frame [m]; no default
    link_inertia_kg_m2 : (N, 3, 3) about the centre of gravity, axes of the link's frame [kg m2]; no default
    gravity_m_s2 : (3,) gravity in the frame the arm is bolted to [m/s2]; a tilted base is a turned vector
    payload : load on the last link
    payload_shift : time_s -> (3,) displacement of the payload's centre of gravity in the last link [m]; None = fixed
    rotor_inertia_kg_m2 : (N,) motor rotor inertia reflected to the joint (ratio squared applied) [kg m2]

    Kinematics
    ----------
    zero_offset_rad : (N,) `q = q_enc + zero_offset`: the true angle is that much larger than the reported one
    compliance_rad_nm : (N,) `q = q_enc + zero_offset - compliance * tau`: the gear winds up under load

    Losses, all on the joint side
    -----------------------------
    stiction_nm : (N,) half-width of the band at rest: a joint stays at rest while
        `|T - tau - bias| <= stiction + ...`
    coulomb_nm : (N,) kinetic friction: moving in direction d, `T - tau = d * coulomb + ...`
    viscous_nm_s_rad : (N,) adds `viscous * qd`
    load_friction : (N,) nu: adds `nu * |tau|` to both the band at rest and the kinetic friction
    creep_rad_s : (N,) initial rate at which a stuck joint creeps under the torque that friction holds (fades with the
        time at rest); the position loop relaxes with it, so a reading at rest is inside the band, not on its edge
    friction_scatter : (N,) standard deviation of the band from one motion to the next, as a share of it
    friction_bias_nm : (N,) half the difference between directions: friction is `d * band + bias`
    gear_efficiency : (N,) eta in (0, 1]; driving `T = eta u`, driven back `T = u / eta`, at rest anywhere between
    passive_torque : (q (N,), time_s, tau (N,)) -> (N,) torque exerted ON the joints by springs, balancers, cables [Nm],
        positive in +q: it relieves the actuator, `tau = gravity - passive_torque`

    Reading chain: what the drive reports of the true motor torque
    --------------------------------------------------------------
    `r = torque_sign * (coupling @ (current_factor * u / torque_constant_scale + reading_offset + ripple)) + noise`

    torque_constant_scale : (N,) true torque constant over the stored one
    current_factor : (N,) reported current over the true one (sqrt 2 or 1 / sqrt 2 where rms and peak are confused)
    reading_offset_nm : (N,) constant added to the reported torque, joint-side [Nm]
    reading_ripple : (q_enc (N,), u (N,)) -> (N,) position-dependent error of the reading, joint-side [Nm]
    coupling : (N, N) mixes the readings: reported axis i shows `sum_j coupling[i, j] * axis j`
    torque_sign : (N,) +1 or -1: -1 reports the torque with the wrong sign (position is right)
    drive_joint : (N,) int: the drive of axis k is bolted to joint drive_joint[k] and reports that joint's position and
        torque; the identity unless nodes are swapped
    reading_noise_nm : (N,) standard deviation of one reading, white, joint-side [Nm]

    Time
    ----
    drift : time_s -> {field name: value} of fields that differ at that instant; see `at`
    temperature_c : time_s -> (N,) motor temperature [deg C]; None = not reported
    """

    link_mass_kg: Array
    link_com_m: Array
    link_inertia_kg_m2: Array
    rotor_inertia_kg_m2: Array
    zero_offset_rad: Array
    compliance_rad_nm: Array
    stiction_nm: Array
    coulomb_nm: Array
    viscous_nm_s_rad: Array
    load_friction: Array
    creep_rad_s: Array
    friction_scatter: Array
    friction_bias_nm: Array
    gear_efficiency: Array
    torque_constant_scale: Array
    current_factor: Array
    reading_offset_nm: Array
    coupling: Array
    torque_sign: Array
    drive_joint: NDArray[np.int64]
    reading_noise_nm: Array
    gravity_m_s2: Array = field(default_factory=_gravity)
    payload: Payload = field(default_factory=Payload)
    payload_shift: Callable[[float], Array] | None = None
    passive_torque: PassiveTorque | None = None
    reading_ripple: ReadingRipple | None = None
    drift: Drift | None = None
    temperature_c: Callable[[float], Array] | None = None

    @property
    def axes(self) -> int:
        """Return the number of axes."""
        return len(self.link_mass_kg)

    def at(self, time_s: float) -> Plant:
        """Plant as it is at one instant: drift applied, the payload's centre of gravity displaced.

        Parameters
        ----------
        time_s : time since the start of the simulation [s]

        Returns
        -------
        Plant whose `drift` and `payload_shift` are None
        """
        changes: dict[str, object] = {"drift": None, "payload_shift": None}
        if self.drift is not None:
            changes.update(self.drift(time_s))
        if self.payload_shift is not None:
            load = self.payload
            changes["payload"] = replace(load, com_m=load.com_m + np.asarray(self.payload_shift(time_s), dtype=float))
        return replace(self, **changes)  # type: ignore[arg-type]

    def with_payload(self, payload: Payload) -> Plant:
        """Return a copy of the plant with another load on the flange."""
        return replace(self, payload=payload)


def nominal_plant(link_mass_kg: Array, link_com_m: Array, link_inertia_kg_m2: Array, **fields: object) -> Plant:
    """Plant of an arm with the given inertials; all other fields stay neutral.

    Parameters
    ----------
    link_mass_kg : (N,) [kg]
    link_com_m : (N, 3), in each link's frame [m]
    link_inertia_kg_m2 : (N, 3, 3), about the centre of gravity, axes of the link's frame [kg m2]
    **fields : further fields of `Plant` by name; sequences become float arrays

    Raises
    ------
    ValueError : a shape does not fit, or a value is not finite
    """
    axes = len(link_mass_kg)
    shapes = {"link_mass_kg": (axes,), "link_com_m": (axes, 3), "link_inertia_kg_m2": (axes, 3, 3)}
    stated = {"link_mass_kg": link_mass_kg, "link_com_m": link_com_m, "link_inertia_kg_m2": link_inertia_kg_m2}
    values: dict[str, object] = {name: np.full(axes, value) for name, value in NEUTRAL.items()}
    values |= {"coupling": np.eye(axes), "drive_joint": np.arange(axes)} | fields
    for name, shape in shapes.items():
        array = np.array(stated[name], dtype=float)
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise ValueError(f"{name} must be a finite array of shape {shape}, got shape {array.shape}")
        values[name] = array
    for name, value in fields.items():
        if isinstance(value, (list, tuple)):
            values[name] = np.array(value, dtype=float)
    return Plant(**values)  # type: ignore[arg-type]
