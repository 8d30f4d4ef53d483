"""Correct names of every mechanism of `nature`, fixed before the first diagnosis of such a cell.

The joints are those that the mechanism was drawn with. Two names are allowed where rest poses cannot distinguish
them even in principle. A constant in the half-sums is the zero of a sensor or friction that differs by direction.
A mechanism without a name is one that no name of the library fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

MECHANISMS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "gas_balancer": ("balancer_spring",),
        "coil_balancer": ("balancer_spring",),
        "clamped_cable": ("cable_torque",),
        "stiffening_gear": ("joint_elasticity",),
        "tilted_base": ("base_tilt",),
        "shifted_zero": ("joint_zero_offset",),
        "dressed_link": ("link_mass",),
        "slipping_load": ("payload_shift",),
        "geared_wrist": ("axis_coupling",),
        "offset_sensor": ("torque_offset", "static_friction"),
        "wrong_constant": ("torque_constant_scale",),
        "strong_ripple": ("torque_ripple",),
        "weak_magnets": ("thermal_drift",),
        "lossy_gear": ("load_dependent_friction",),
        "one_way_drag": ("static_friction", "torque_offset"),
        "turned_sign": ("sign_reversed",),
        "exchanged_cables": ("axes_swapped",),
        "rms_for_peak": ("current_rms_peak",),
        "saturated_current": (),
        "end_stop": (),
        "detents": (),
        "gusts": (),
        "moody_gear": (),
        "tether": (),
        "half_full_tank": (),
    }
)
