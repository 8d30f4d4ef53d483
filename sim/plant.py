"""What the simulated arm obeys and the gateway is never told.

A `Plant` is a complete description of the physics of one arm: its true inertials, what the gears lose, what the
sensors report wrongly, what hangs on the flange. Every field is neutral by default, so that a plant without effects is
exactly the arm of the URDF with ideal gears. Effects are functions from one plant to the next
(`dataclasses.replace`); the bus simulation and the tables computed without a bus read the same fields and therefore
obey the same physics.

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


def _zeros() -> Array:
    return np.zeros(6)


def _ones() -> Array:
    return np.ones(6)


def _gravity() -> Array:
    return np.array([0.0, 0.0, -GRAVITY_M_S2])


def _order() -> NDArray[np.int64]:
    return np.arange(6)


@dataclass(frozen=True, slots=True)
class Payload:
    """A rigid body bolted to link 6.

    Attributes
    ----------
    label : name that commands and result files use
    mass_kg : mass [kg]; 0 is an empty flange
    com_m : array of shape (3,), centre of gravity in the link_6 frame [m]
    inertia_kg_m2 : array of shape (3, 3), about the centre of gravity, axes of link_6 [kg m2]
    """

    label: str = "none"
    mass_kg: float = 0.0
    com_m: Array = field(default_factory=lambda: np.zeros(3))
    inertia_kg_m2: Array = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Plant:
    """True physics of one six-axis arm; all defaults are neutral.

    Rigid body
    ----------
    link_mass_kg : (6,) true mass of each link [kg]; no default
    link_com_m : (6, 3) true centre of gravity in each link's frame [m]; no default
    link_inertia_kg_m2 : (6, 3, 3) about the centre of gravity, axes of the link's frame [kg m2]; no default
    gravity_m_s2 : (3,) gravity in the frame the arm is bolted to [m/s2]; a tilted base is a turned vector
    payload : what hangs on link 6
    payload_shift : time_s -> (3,) displacement of the payload's centre of gravity in link_6 [m]; None = rigidly fixed
    rotor_inertia_kg_m2 : (6,) motor rotor inertia reflected to the joint (ratio squared applied) [kg m2]

    Kinematics
    ----------
    zero_offset_rad : (6,) `q = q_enc + zero_offset`: the true angle is that much larger than the reported one
    compliance_rad_nm : (6,) `q = q_enc + zero_offset - compliance * tau`: the gear winds up under load

    Losses, all on the joint side
    -----------------------------
    stiction_nm : (6,) half-width of the band at rest: a joint stays at rest while
        `|T - tau - bias| <= stiction + ...`
    coulomb_nm : (6,) kinetic friction: moving in direction d, `T - tau = d * coulomb + ...`
    viscous_nm_s_rad : (6,) adds `viscous * qd`
    load_friction : (6,) nu: adds `nu * |tau|` to both the band at rest and the kinetic friction
    creep_rad_s : (6,) initial rate at which a stuck joint creeps under the torque that friction holds (fades with the
        time at rest); the position loop relaxes with it, so a reading at rest lies inside the band, not on its edge
    friction_scatter : (6,) standard deviation of the band from one motion to the next, as a share of it
    friction_bias_nm : (6,) half the difference between directions: friction is `d * band + bias`
    gear_efficiency : (6,) eta in (0, 1]; driving `T = eta u`, driven back `T = u / eta`, at rest anywhere between
    passive_torque : (q (6,), time_s, tau (6,)) -> (6,) torque exerted ON the joints by springs, balancers, cables [Nm],
        positive in +q: it relieves the actuator, `tau = gravity - passive_torque`

    Reading chain: what the drive reports of the true motor torque
    --------------------------------------------------------------
    `r = torque_sign * (coupling @ (current_factor * u / torque_constant_scale + reading_offset + ripple)) + noise`

    torque_constant_scale : (6,) true torque constant over the stored one
    current_factor : (6,) reported current over the true one (sqrt 2 or 1 / sqrt 2 where rms and peak are confused)
    reading_offset_nm : (6,) constant added to what is reported, joint-side [Nm]
    reading_ripple : (q_enc (6,), u (6,)) -> (6,) position-dependent error of the reading, joint-side [Nm]
    coupling : (6, 6) mixes the readings: reported axis i shows `sum_j coupling[i, j] * axis j`
    torque_sign : (6,) +1 or -1: -1 reports the torque with the wrong sign (position is right)
    drive_joint : (6,) int: the drive of axis k is bolted to joint drive_joint[k] and reports that joint's position and
        torque; the identity unless nodes are swapped
    reading_noise_nm : (6,) standard deviation of one reading, white, joint-side [Nm]

    Time
    ----
    drift : time_s -> {field name: value} of fields that differ at that instant; see `at`
    temperature_c : time_s -> (6,) motor temperature [deg C]; None = not reported
    """

    link_mass_kg: Array
    link_com_m: Array
    link_inertia_kg_m2: Array
    gravity_m_s2: Array = field(default_factory=_gravity)
    payload: Payload = field(default_factory=Payload)
    payload_shift: Callable[[float], Array] | None = None
    rotor_inertia_kg_m2: Array = field(default_factory=_zeros)
    zero_offset_rad: Array = field(default_factory=_zeros)
    compliance_rad_nm: Array = field(default_factory=_zeros)
    stiction_nm: Array = field(default_factory=_zeros)
    coulomb_nm: Array = field(default_factory=_zeros)
    viscous_nm_s_rad: Array = field(default_factory=_zeros)
    load_friction: Array = field(default_factory=_zeros)
    creep_rad_s: Array = field(default_factory=_zeros)
    friction_scatter: Array = field(default_factory=_zeros)
    friction_bias_nm: Array = field(default_factory=_zeros)
    gear_efficiency: Array = field(default_factory=_ones)
    passive_torque: PassiveTorque | None = None
    torque_constant_scale: Array = field(default_factory=_ones)
    current_factor: Array = field(default_factory=_ones)
    reading_offset_nm: Array = field(default_factory=_zeros)
    reading_ripple: ReadingRipple | None = None
    coupling: Array = field(default_factory=lambda: np.eye(6))
    torque_sign: Array = field(default_factory=_ones)
    drive_joint: NDArray[np.int64] = field(default_factory=_order)
    reading_noise_nm: Array = field(default_factory=_zeros)
    drift: Drift | None = None
    temperature_c: Callable[[float], Array] | None = None

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
        """The same plant with another load on the flange."""
        return replace(self, payload=payload)


def nominal_plant(link_mass_kg: Array, link_com_m: Array, link_inertia_kg_m2: Array, **fields: object) -> Plant:
    """Plant of an arm with the given inertials; whatever is not named stays neutral.

    Parameters
    ----------
    link_mass_kg : (6,) [kg]
    link_com_m : (6, 3), in each link's frame [m]
    link_inertia_kg_m2 : (6, 3, 3), about the centre of gravity, axes of the link's frame [kg m2]
    **fields : further fields of `Plant` by name; sequences become float arrays

    Raises
    ------
    ValueError : a shape does not fit, or a value is not finite
    """
    shapes = {"link_mass_kg": (6,), "link_com_m": (6, 3), "link_inertia_kg_m2": (6, 3, 3)}
    given = {"link_mass_kg": link_mass_kg, "link_com_m": link_com_m, "link_inertia_kg_m2": link_inertia_kg_m2}
    values: dict[str, object] = dict(fields)
    for name, shape in shapes.items():
        array = np.array(given[name], dtype=float)
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise ValueError(f"{name} must be a finite array of shape {shape}, got shape {array.shape}")
        values[name] = array
    for name, value in fields.items():
        if isinstance(value, (list, tuple)):
            values[name] = np.array(value, dtype=float)
    return Plant(**values)  # type: ignore[arg-type]
