"""Motion control of a simulated drive by CiA 402 state and mode: reference, brake, ramps, monitoring.

The reference advances once per stretch of simulated time (one SYNC in lockstep); the servo loop moves it evenly over
the milliseconds of that stretch, which is the linear interpolation of cyclic synchronous position. In real time, a
setpoint waits for the drive's own clock, which a phase-locked loop keeps half a period behind the SYNCs. Setpoints may
therefore arrive up to half a period early or delayed. At a tick the newest setpoint is taken, as there is one target
position (0x607A) and no queue; without a new one the reference is extrapolated.

Interpolated position (mode 7) does the same with the records of 0x60C1: each SYNC takes one out of a buffer. Bit 4 of
the controlword starts the interpolation by its rise in OPERATION ENABLED, and ends it when it drops.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from canopen.sdo.exceptions import SdoAbortedError

from sim.cellfile import AxisSpec
from sim.makes import DriveUnits
from sim.motor import Motor
from sim.objects import DEVICE_STATE, VALUE_RANGE, ObjectStore
from sim.servo import TICK_S
from sim.states import Automaton, PdsState

PP, IP, CSP, CST = 1, 7, 8, 10
#: Modes of operation (0x6060), and their bits of 0x6502.
MODES = {PP: 0, IP: 6, CSP: 7, CST: 9}
POLARITY_POSITION = 0x80
NEW_SET_POINT, RELATIVE, HALT = 1 << 4, 1 << 6, 1 << 8
TARGET_REACHED, INTERNAL_LIMIT, MODE_SPECIFIC, FOLLOWING_ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
EMCY_FOLLOWING = 0x8611
#: A stopping axis counts as at rest below this speed [rad/s], or this long after its ramp in any case [s].
STANDSTILL_RAD_S = 0.02
#: Option codes: reaction when leaving OPERATION ENABLED, and during a quick stop or a fault.
QUICK_STOP_OPTION, HALT_OPTION = (0x605A, 0), (0x605D, 0)
LEAVING = {PdsState.READY_TO_SWITCH_ON: (0x605B, 0), PdsState.SWITCHED_ON: (0x605C, 0)}
STOPPING = {PdsState.QUICK_STOP_ACTIVE: QUICK_STOP_OPTION, PdsState.FAULT_REACTION_ACTIVE: (0x605E, 0)}
SLOW_DOWN_RAMP, QUICK_STOP_RAMP = 0x6084, 0x6085
STOP_TIMEOUT_S = 0.3
#: Share of its phase error that the drive's own clock corrects in a period, and the largest correction.
CLOCK_PULL, CLOCK_DRAW = 0.01, 0.03
#: Ticks without a setpoint after which the reference is at rest: extrapolated for one period, then slower.
MISSED_UNTIL_REST = 2


class DriveMotion:
    """Setpoints, reference generator and monitor of one drive.

    Parameters
    ----------
    spec : axis of the cell that the drive moves
    units : scaling of its objects
    store : its objects
    axis : its motor
    automaton : its state machine
    raise_fault : sends an EMCY with an error code, then starts the fault reaction

    Attributes
    ----------
    counts_per_joint_rad : of the position at the gear output, with the sign of the cell
    mode : 0x6060 (0 none, 1 PP, 7 IP, 8 CSP, 10 CST)
    target_counts, velocity_offset, torque_offset, target_torque : setpoints as received
    record_counts, record_depth : setpoint of mode 7 (0x60C1) received last, and how many of them the buffer holds
    interpolating : mode 7 follows its setpoints
    target_limited : the target position was cut by a software limit
    brake_stuck : the holding brake does not open
    wobble : amplitude [rad] and frequency [Hz] of a loop that hunts and never comes to rest
    buffered : a setpoint waits for the drive's own clock
    brake_closing_s : time that the brake takes to close after the motor of a standing axis is off [s]
    """

    def __init__(
        self,
        spec: AxisSpec,
        units: DriveUnits,
        store: ObjectStore,
        axis: Motor,
        automaton: Automaton,
        raise_fault: Callable[[int], None],
    ) -> None:
        self._spec, self._units, self._store, self._axis = spec, units, store, axis
        self._automaton, self._raise_fault = automaton, raise_fault
        self.counts_per_joint_rad = spec.position_sign * spec.gear_ratio * units.counts_per_rad
        self.mode = self.target_counts = self.velocity_offset = self.torque_offset = self.target_torque = 0
        self.record_counts, self.record_depth, self.interpolating = 0, 1, False
        self._records: list[int] = []
        #: Position that the reference follows, of 0x607A or of a record [counts].
        self._setpoint_counts = 0
        self.target_limited = False
        self.brake_stuck = False
        self.wobble: tuple[float, float] | None = None
        self.buffered = False
        self.brake_closing_s = 0.0
        #: Setpoint that no tick has taken yet.
        self._waiting_rad: float | None = None
        self._goal = self._since_s = 0.0
        #: Ticks in a row without a setpoint.
        self._missed = MISSED_UNTIL_REST + 1
        self._wobbled = 0.0
        self._speed = 0.0
        self._left_s = 0.0
        self._stopping_s = 0.0
        self._release_s: float | None = None
        self._lock_s: float | None = None
        self._then: PdsState | None = None
        self._pp_goal: float | None = None
        self._acknowledged = False
        self._reached_since: float | None = None
        self._lag_since: float | None = None
        self._time_s = 0.0

    # --------------------------------------------------------------------------------------------------- setpoints

    @property
    def polarity(self) -> int:
        """Return the sign of positions and speeds (0x607E)."""
        return -1 if self._store.number((0x607E, 0)) & POLARITY_POSITION else 1

    def reset(self, mode: int) -> None:
        """Set the mode, and targets and offsets to their values at power-up."""
        self.mode, self.torque_offset, self.target_torque = mode, 0, 0
        self.take_velocity_offset(0)
        self.record_counts = 0
        self._end_interpolation()
        self.target_counts = self._setpoint_counts = self._counts(self._axis.position_rad)

    def _counts(self, position_rad: float) -> int:
        return self.polarity * round(position_rad * self.counts_per_joint_rad)

    def take_mode(self, value: int) -> None:
        """Set the mode of operation (0x6060); if enabled, it starts from the present reference."""
        if value not in MODES and value != 0:
            raise SdoAbortedError(VALUE_RANGE)
        if value != self.mode:
            self._end_interpolation()
            self._acknowledged |= value == IP  # bit 4 has to rise again
            self._setpoint_counts = self.target_counts
        self.mode = value
        self._pp_goal = None
        self.feed_torque()

    def take_target(self, counts: int) -> None:
        """Set the target position (0x607A)."""
        self.target_counts = counts
        if self.mode != IP:
            self._follow(counts)

    def take_record(self, counts: int) -> None:
        """Put a setpoint of mode 7 (0x60C1) into the buffer; a full one loses its oldest."""
        self.record_counts = counts
        self._records = [*self._records, counts][-self.record_depth :]

    def take_next(self) -> None:
        """Take a setpoint out of the buffer of mode 7, at a SYNC."""
        if self.interpolating and self._records:
            self._follow(self._records.pop(0))

    def refuse_period(self, _value: int) -> None:
        """Refuse another interpolation period (0x60C2) while mode 7 is active."""
        if self.interpolating:
            raise SdoAbortedError(DEVICE_STATE)

    def _end_interpolation(self) -> None:
        self.interpolating = False
        self._records.clear()

    def _follow(self, counts: int) -> None:
        """Set the position that is to be reached within the interpolation period (0x60C2)."""
        self._setpoint_counts = counts
        if self.buffered:
            if self._missed > MISSED_UNTIL_REST and self._waiting_rad is None:  # the clock is unused: set it
                self._left_s = 0.5 * self.period_s()
            self._waiting_rad, self._since_s = self.target_rad(), 0.0
        else:
            self._left_s = self.period_s()

    def target_rad(self) -> float:
        """Return the setpoint at the gear output, clipped to the software limits (0x607D; both 0 = no limits) [rad]."""
        counts = self._setpoint_counts
        low, high = self._store.number((0x607D, 1)), self._store.number((0x607D, 2))
        if low != 0 or high != 0:
            counts = min(max(counts, low), high)
        self.target_limited = counts != self._setpoint_counts
        return self.polarity * counts / self.counts_per_joint_rad

    def joint_speed(self, word: int) -> float:
        """Convert an unsigned velocity value of the drive to a joint speed [rad/s]."""
        return word / (self._units.velocity.bits_per_unit * abs(self._spec.gear_ratio))

    def joint_ramp(self, word: int) -> float:
        """Convert an unsigned acceleration value of the drive to a joint acceleration [rad/s2]."""
        bits = self._units.ramp_bits or self._units.velocity.bits_per_unit
        return word / (bits * abs(self._spec.gear_ratio))

    def take_velocity_offset(self, value: int) -> None:
        """Set the velocity offset (0x60B1)."""
        self.velocity_offset = value
        motor = value / self._units.velocity.bits_per_unit
        self._axis.servo.offset_rad_s = self.polarity * motor / (self._spec.position_sign * self._spec.gear_ratio)

    def take_torque_offset(self, word: int) -> None:
        """Set the torque offset (0x60B2)."""
        self.torque_offset = word
        self.feed_torque()

    def take_target_torque(self, word: int) -> None:
        """Set the target torque (0x6071)."""
        self.target_torque = word
        self.feed_torque()

    # ------------------------------------------------------------------------------------------------------ states

    def state_changed(self, before: PdsState) -> None:
        """React to a transition, or to a controlword within OPERATION ENABLED."""
        state = self._automaton.state
        leaves = before is PdsState.OPERATION_ENABLED and self._axis.fed and state in LEAVING
        if leaves and self._store.number(LEAVING[state]) == 1:  # first the ramp, then the transition
            self._then, self._automaton.state = state, before
            return
        self._then = None
        if state in STOPPING and state is not before and self._store.number(STOPPING[state]) == 0:
            self._automaton.stopped()
        self._entered(before)

    def _entered(self, before: PdsState) -> None:
        state = self._automaton.state
        if state is PdsState.OPERATION_ENABLED:
            if before is not PdsState.OPERATION_ENABLED:
                self._release_s = self._time_s + self._brake_delay_s()
                self._lock_s = None
                self._unlock()
                # bit 4 starts the interpolation by its rise in this state only
                self._pp_goal, self._acknowledged = None, self.mode == IP
            self._handshake()
            return
        self._end_interpolation()
        if not self._automaton.energised:
            self._disable()

    def _unlock(self) -> None:
        """Stop the drive's clock: the next setpoint starts it."""
        self._waiting_rad, self._left_s, self._missed = None, 0.0, MISSED_UNTIL_REST + 1

    def _brake_delay_s(self) -> float:
        return float(self._spec.profile.get("state_machine", {}).get("brake_delay_s", 0.0))

    def _disable(self) -> None:
        """Disable the drive function: a standing axis is handed to its brake, a moving one coasts until it falls in."""
        axis = self._axis
        self._release_s = None
        self._speed = self._stopping_s = 0.0
        if axis.fed and (self.brake_closing_s or abs(axis.omega_rad_s) > STANDSTILL_RAD_S):
            axis.coast()
            self._lock_s = self._time_s + max(self._brake_delay_s(), self.brake_closing_s)
        elif self._lock_s is None:
            axis.lock()

    def feed_torque(self) -> None:
        """Apply the torque offset, in CST the whole torque demand, to the servo loop."""
        servo, spec = self._axis.servo, self._spec
        word = self.torque_offset + (self.target_torque if self.mode == CST else 0)
        servo.offset_nm = word * self._units.offset_nm_per_bit * spec.torque_sign * spec.gear_ratio
        servo.torque_only = self.mode == CST and self._automaton.state is PdsState.OPERATION_ENABLED

    def _handshake(self) -> None:
        """Process bit 4: its rise accepts a setpoint in PP, acknowledged by bit 12, and starts interpolation in IP."""
        if self.mode not in (PP, IP):
            return
        wanted = bool(self._automaton.controlword & NEW_SET_POINT)
        rises = wanted and not self._acknowledged
        if self.mode == IP and rises:
            self.interpolating, self._setpoint_counts = True, self._counts(self._axis.servo.reference_rad)
            self._unlock()
        elif self.mode == IP and not wanted:
            self._end_interpolation()
        elif rises:
            goal = self.target_rad()
            if self._automaton.controlword & RELATIVE:
                goal += self._axis.servo.reference_rad
            self._pp_goal, self._reached_since = goal, None
        self._acknowledged = wanted

    # ---------------------------------------------------------------------------------------------------- reference

    def plan(self, ticks: float) -> None:
        """Set the increments of the reference for the milliseconds to come."""
        state = self._automaton.state
        if not self._automaton.energised:
            if self._lock_s is not None and self._time_s >= self._lock_s:
                self._lock_s = None
                self._axis.lock()
            return
        if not self._axis.fed:
            open_ = self._release_s is not None and not self.brake_stuck
            # the motor holds an axis before the brake has opened: that is seen where the brake does not hold it
            open_ = open_ and (self._axis.falls or self._time_s >= (self._release_s or 0.0))
            if open_ and self.mode:
                self._axis.release()
                self._unlock()
                self.feed_torque()
            elif state is not PdsState.OPERATION_ENABLED:
                self._automaton.stopped()
                self.state_changed(state)
            return
        seconds = ticks * TICK_S
        if state is not PdsState.OPERATION_ENABLED:
            gentle = self._store.number(STOPPING[state]) in (1, 5)
            self._move(self._ramp_down(seconds, SLOW_DOWN_RAMP if gentle else QUICK_STOP_RAMP), ticks)
            return
        if self._then is not None:
            self._move(self._ramp_down(seconds, SLOW_DOWN_RAMP), ticks)
            return
        idle = {PP: self._pp_goal is None, IP: not self.interpolating}.get(self.mode)
        if idle or (idle is not None and self._automaton.controlword & HALT):
            quick = self._store.number(HALT_OPTION) == 2
            self._move(self._ramp_down(seconds, QUICK_STOP_RAMP if quick else SLOW_DOWN_RAMP), ticks)
            return
        self._speed = self._move(self._commanded(seconds), ticks)

    def _commanded(self, seconds: float) -> float:
        """Return the movement [rad] commanded by the master in its mode."""
        servo = self._axis.servo
        if self.mode in (IP, CSP):
            return self._track(seconds)
        if self.mode == PP:
            return self._profile(seconds)
        servo.reference_rad = self._axis.position_rad
        return 0.0

    def _move(self, travel_rad: float, ticks: float) -> float:
        """Distribute the movement over the milliseconds; return its speed [rad/s]."""
        seconds = ticks * TICK_S
        self.feed_torque()
        travel = travel_rad + self._hunting(seconds)
        self._axis.servo.reference_step_rad = travel / ticks
        return travel / seconds

    def period_s(self) -> float:
        """Return the interpolation period (0x60C2), at least a millisecond [s]."""
        store = self._store
        return max(store.number((0x60C2, 1)) * 10.0 ** store.number((0x60C2, 2)), TICK_S)

    def _by_own_clock(self, seconds: float) -> float:
        """Return the movement of the reference [rad] when setpoints wait for a tick.

        Without one the axis continues for a period, as drives do that extrapolate, then slows down to a stop.
        """
        at = self._axis.servo.reference_rad - self._wobbled
        begin, period_s = at, self.period_s()
        while seconds > 1e-9:
            if self._left_s <= 1e-9:
                self._tick(period_s)
            step = min(seconds, self._left_s)
            if self._missed:
                step = min(step, 0.001)
                gone = self._missed - self._left_s / period_s
                at += self._speed * step * min(max(0.0, MISSED_UNTIL_REST - gone), 1.0)
            else:
                at += (self._goal - at) * step / self._left_s
            self._left_s -= step
            self._since_s += step
            seconds -= step
        return at - begin

    def _tick(self, period_s: float) -> None:
        """Begin a period of the drive's own clock, with a setpoint or without."""
        if self._waiting_rad is None:
            self._missed += 1
            self._left_s = period_s
            return
        self._goal, self._waiting_rad, self._missed = self._waiting_rad, None, 0
        behind = self._since_s / period_s - 0.5
        self._left_s = period_s * (1.0 - min(max(CLOCK_PULL * behind, -CLOCK_DRAW), CLOCK_DRAW))

    def _track(self, seconds: float) -> float:
        """Return the movement in CSP and IP: the remaining distance, evenly over the remaining period."""
        if self.buffered:
            travel = self._by_own_clock(seconds)
        else:
            way = self.target_rad() + self._wobbled - self._axis.servo.reference_rad
            travel = way * seconds / self._left_s if self._left_s > seconds else way
            self._left_s = max(self._left_s - seconds, 0.0)
        most = self._axis.servo.max_rad_s * seconds
        self.target_limited |= abs(travel) > most
        return min(max(travel, -most), most)

    def _hunting(self, seconds: float) -> float:
        if self.wobble is None:
            return 0.0
        amplitude, frequency = self.wobble
        before = self._wobbled
        self._wobbled = amplitude * math.sin(2.0 * math.pi * frequency * (self._time_s + seconds))
        return self._wobbled - before

    def _profile(self, seconds: float) -> float:
        """Return the movement in profile position mode: trapezoid of 0x6081, 0x6083, 0x6084."""
        goal = self._axis.servo.reference_rad if self._pp_goal is None else self._pp_goal
        way = goal - self._axis.servo.reference_rad
        top = self.joint_speed(self._store.number((0x6081, 0)))
        up, down = (self.joint_ramp(self._store.number((index, 0))) for index in (0x6083, 0x6084))
        speed = min(top, abs(self._speed) + up * seconds, math.sqrt(2.0 * down * abs(way)))
        travel = math.copysign(min(speed * seconds, abs(way)), way)
        return way if abs(way - travel) < 1e-9 else travel

    def _ramp_down(self, seconds: float, index: int) -> float:
        """Stop with the deceleration of an object; notify the state machine when the reference is at rest."""
        rate = self.joint_ramp(self._store.number((index, 0)))
        slower = max(abs(self._speed) - rate * seconds, 0.0)
        travel = math.copysign(0.5 * (abs(self._speed) + slower) * seconds, self._speed)
        self._speed = math.copysign(slower, self._speed)
        self._stopping_s = self._stopping_s + seconds if slower == 0.0 else 0.0
        still = slower == 0.0 and abs(self._axis.omega_rad_s) < STANDSTILL_RAD_S
        stops = self._then is not None or self._automaton.state is not PdsState.OPERATION_ENABLED
        if stops and (still or self._stopping_s > STOP_TIMEOUT_S):
            self._stopped()
        return travel

    def _stopped(self) -> None:
        """End the transition that waits for the axis to be at rest."""
        automaton = self._automaton
        before = automaton.state
        if self._then is not None:
            automaton.state, self._then = self._then, None
        else:
            automaton.stopped()
        self._entered(before)

    # --------------------------------------------------------------------------------------------------- monitoring

    def supervise(self, time_s: float) -> None:
        """Monitor the following error and the target reached condition."""
        self._time_s = time_s
        if not self._axis.fed or self.mode == CST:
            self._lag_since = None
            return
        error = abs(round(self._axis.servo.error_rad * self.counts_per_joint_rad))
        if error > self._store.number((0x6065, 0)):
            self._lag_since = time_s if self._lag_since is None else self._lag_since
            if time_s - self._lag_since >= self._store.number((0x6066, 0)) * 1e-3:
                self._raise_fault(EMCY_FOLLOWING)
        else:
            self._lag_since = None
        at_goal = self._pp_goal is not None and abs(self._pp_goal - self._axis.servo.reference_rad) < 1e-9
        if at_goal and error <= self._store.number((0x6067, 0)):
            self._reached_since = time_s if self._reached_since is None else self._reached_since
        else:
            self._reached_since = None

    def status_bits(self, error_code: int) -> int:
        """Return bits 10 to 13 of the statusword, for the value of 0x603F."""
        bits = 0
        if self._automaton.state is PdsState.OPERATION_ENABLED:
            if self.target_limited or self._axis.servo.limited:
                bits |= INTERNAL_LIMIT
            if self.mode == PP:
                bits |= MODE_SPECIFIC if self._acknowledged else 0
                wait = self._store.number((0x6068, 0)) * 1e-3
                if self._reached_since is not None and self._time_s - self._reached_since >= wait:
                    bits |= TARGET_REACHED
            elif (self._axis.fed or self.brake_stuck) and (self.mode != IP or self.interpolating):
                bits |= MODE_SPECIFIC  # a drive does not notice that its brake falls in
            if self._lag_since is not None:
                bits |= FOLLOWING_ERROR
        elif error_code == EMCY_FOLLOWING:
            bits |= FOLLOWING_ERROR
        return bits
