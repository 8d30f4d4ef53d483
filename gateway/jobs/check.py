"""Check an arm: computer, bus and drives without motion; signs, stop and brakes with it."""

from __future__ import annotations

from typing import Any

from drives.realtime import available
from gateway.check.brakes import try_brakes
from gateway.check.moves import check_moves
from gateway.check.proofs import keep_proof, proven_on
from gateway.check.stop import prove_stop
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import AT_HAND, LITTLE_MOTION, WITHHELD, Operator, begin_motion
from gateway.model.arm_model import arm_named
from gateway.motion.stream import MoveOptions
from gateway.preflight.machine import judge_realtime
from gateway.result.finding import Finding


def check(context: CellContext, *, arm: str | None = None) -> list[Finding]:
    """Check computer, bus and drives of an arm against profile and cell file; nothing is written, nothing moves.

    Parameters
    ----------
    context : CellContext
    arm : str, optional
        Name of the arm, if the cell has several.

    Raises
    ------
    ConfigError, PlanRefused, DriveError
        The cell contradicts its robot, or a drive does not answer.
    """
    config = arm_named(context.loaded, arm)
    machine = [judge_realtime(available())] if config is context.arms[0] else []  # reported once, for the first arm
    return machine + context.check(config)


def check_moving(
    context: CellContext,
    operator: Operator,
    options: MoveOptions,
    *,
    arm: str | None = None,
    small_moves: bool = False,
    stop: bool = False,
    brakes: bool = False,
) -> tuple[list[Finding], list[dict[str, Any]]]:
    """Check an arm in motion, after confirmation; the stop is proven first where no proof of it is stored.

    Parameters
    ----------
    context : CellContext
    operator : Operator
    options : MoveOptions
        As `stoppable` yields them.
    arm : str, optional
        Name of the arm, if the cell has several.
    small_moves : bool
        Move each joint a little: signs, axis order, gear ratios, torque.
    stop : bool
        Prove the stop on loss of the master, also where a proof is stored.
    brakes : bool
        Let each brake in turn hold its axis.

    Returns
    -------
    findings : list of Finding
    proofs : list of dict
        The proof of the stop, as plain values.

    Raises
    ------
    PlanRefused, LimitExceeded, DriveError, KeyboardInterrupt
        The arm was stopped, and its brakes are on.
    """
    config = arm_named(context.loaded, arm)
    findings: list[Finding] = []
    proofs: list[dict[str, Any]] = []
    path = context.stop_proof(config)
    with context.opened(config) as opened, context.last_seconds(options, opened):
        proves = stop or proven_on(path, opened, options.override) is None
        what = LITTLE_MOTION + WITHHELD * proves
        if brakes:
            what += ", and each axis in turn is held by its brake alone (its drive takes over if the brake slips)"
        options = begin_motion(context, (opened,), options, operator, what=what, also=AT_HAND, proof="own")
        if proves:
            proof = prove_stop(opened, options)
            keep_proof(path, opened, proof)
            findings += proof.items
            proofs.append(proof.as_json())
            if not proof.passed:
                return findings, proofs
        if brakes:
            findings += try_brakes(opened, options, operator.support)
        if small_moves and not any(item.severity == "fail" for item in findings):  # no power on a brake that slips
            with operator.progress(1.0, "small moves") as listener:
                findings += check_moves(opened, (listener,), options)
    return findings, proofs
