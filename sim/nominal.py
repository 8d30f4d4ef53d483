"""The arm of a cell file as a plant without effects: inertials of the URDF, typical gears, typical sensors."""

from __future__ import annotations

import numpy as np

from sim.cellfile import ArmSpec
from sim.plant import Plant, nominal_plant
from sim.units import OVERLOAD
from sim.urdf import UrdfError

#: Coulomb friction of a geared servo axis, share of its peak torque, assumed.
COULOMB_SHARE = 0.008
STICTION_OVER_COULOMB = 1.12
#: Viscous friction at the speed limit over Coulomb friction.
VISCOUS_SHARE = 0.5
#: Torque noise of one reading, share of the rated torque.
NOISE_SHARE = 0.003
#: Acceleration that the torque limit gives the motor's own rotor [rad/s2, joint side].
ROTOR_ACCELERATION_RAD_S2 = 40.0
CREEP_RAD_S = 2e-4
#: Scatter of the friction band from one motion to the next, assumed.
SCATTER = 0.1


def plant_of(arm: ArmSpec) -> Plant:
    """Plant of an arm as its cell file and its URDF describe it.

    Raises
    ------
    UrdfError : a link without inertial
    """
    bodies = arm.chain.bodies
    for number, body in enumerate(bodies, start=1):
        if body is None:
            raise UrdfError(f"robot of arm '{arm.name}': link {number} has no <inertial>; the simulator needs them all")
    limit = np.array([axis.torque_limit_nm for axis in arm.axes])
    speed = np.array([axis.speed_limit_rad_s for axis in arm.axes])
    efficiency = np.array([axis.gear_efficiency for axis in arm.axes])
    return nominal_plant(
        np.array([body.mass_kg for body in bodies if body is not None]),
        np.array([body.com_m for body in bodies if body is not None]),
        np.array([body.inertia_kg_m2 for body in bodies if body is not None]),
        gravity_m_s2=arm.gravity_m_s2,
        rotor_inertia_kg_m2=limit / ROTOR_ACCELERATION_RAD_S2,
        coulomb_nm=COULOMB_SHARE * limit,
        stiction_nm=STICTION_OVER_COULOMB * COULOMB_SHARE * limit,
        viscous_nm_s_rad=VISCOUS_SHARE * COULOMB_SHARE * limit / speed,
        creep_rad_s=np.full(len(bodies), CREEP_RAD_S),
        friction_scatter=np.full(len(bodies), SCATTER),
        gear_efficiency=efficiency,
        reading_noise_nm=NOISE_SHARE * limit / (efficiency * OVERLOAD),
    )
