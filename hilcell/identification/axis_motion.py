"""One axis at constant speed, by a tracker's stream and joint readings.

Tracker and robot have no common clock: delays leave a constant lag, determined by
`hilcell.identification.sweeps` from the two directions of a sweep. Readings are never paired one by
one: the joints give one straight line in time, the tracker its deviations. A controller that
time-stamps its joints is related to the cell's clock as the tracker is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hilcell.geometry.kinematics import Arm, Array, Bools, forward, link_transforms
from hilcell.ports import HilcellError

LEAST_SAMPLES, LEAST_READINGS = 100, 12


class BadStream(HilcellError):
    """A sweep with unusable streams; the message names the reason."""

    code = "HC-V06"


@dataclass(frozen=True, slots=True)
class SweepStream:
    """One sweep of one axis: N samples of the tracker, M readings of the joints; times in s."""

    RADIUS_MM = 20.0  # by which the reflector's circle may miss the nominal one

    device_s: Array  # (N,) the tracker's own clock
    xyz_mm: Array  # (N, 3) in {B}; as the file has it, in the tracker's frame
    window_s: Array  # (N, 2) the cell's clock: between these the sample arrived
    joints_rad: Array  # (M, 6)
    asked_s: Array  # (M, 2) the cell's clock before and after each exchange
    stamped_s: Array  # (M,) the controller's own clock; NaN where it does not say

    def check_numbers(self) -> None:
        """Refuse streams that are too short, not finite, or whose times run back."""
        for name, values in (
            ("times of the tracker", self.device_s),
            ("positions", self.xyz_mm),
            ("arrival windows", self.window_s),
            ("joints", self.joints_rad),
            ("times of the joints", self.asked_s),
        ):
            if not bool(np.all(np.isfinite(values))):
                raise BadStream(f"{name}: {np.sum(~np.isfinite(values))} values are not finite")
        if not (len(self.device_s) >= LEAST_SAMPLES and len(self.joints_rad) >= LEAST_READINGS):
            raise BadStream(
                f"{len(self.device_s)} samples and {len(self.joints_rad)} joint readings, expected "
                f">= {LEAST_SAMPLES} and {LEAST_READINGS}: sweep further or sample faster"
            )
        if not bool(np.all(np.diff(self.device_s) > 0)):
            raise BadStream("the samples' times run back: the tracker's clock was set; sweep again")
        if not bool(np.all(np.isnan(self.stamped_s)) or np.all(np.diff(self.stamped_s) > 0)):
            raise BadStream(
                "the controller's times of the joints run back, or some are missing; sweep again"
            )

    def joint_line(self, axis: int, angle_rad: Array) -> tuple[float, float, float, float]:
        """Line through the axis's readings at the constant speed of the sweep. Time in the cell's,
        joint angle then, speed, and the standard uncertainty of the time.
        """
        others = np.delete(self.joints_rad, axis, axis=1)
        moved_rad = np.ptp(others, axis=0).max()
        others_rad = 1e-3  # by which the other axes may seem to move
        if not moved_rad <= others_rad:
            raise BadStream(
                f"another axis turned by {np.degrees(moved_rad):.3f} deg during the sweep, "
                f"expected <= {np.degrees(others_rad):.3f} deg"
            )
        read_rad = self.joints_rad[:, axis]
        read_s, prompt, clock_s = self._read_times()
        low, high = sorted((angle_rad[0], angle_rad[-1]))
        edge = 0.02 * (high - low)
        used = (read_rad > low + edge) & (read_rad < high - edge)
        used &= prompt
        if not np.count_nonzero(used) >= LEAST_READINGS:
            raise BadStream(
                f"{np.count_nonzero(used)} joint readings at constant speed, expected >= "
                f"{LEAST_READINGS}: the joints are another sweep's, or were asked for too rarely"
            )
        read_rad, read_s = read_rad[used], read_s[used]
        centre_s = float(read_s.mean())
        slope, middle = np.polyfit(read_s - centre_s, read_rad, 1)
        off_rad = np.abs(read_rad - middle - slope * (read_s - centre_s))
        uneven_rad = 3e-3  # of a joint's reading from the line in time
        if not off_rad.max() <= uneven_rad:
            raise BadStream(
                f"a joint reading is {np.degrees(off_rad.max()):.3f} deg off the constant speed, "
                f"expected <= {np.degrees(uneven_rad):.3f} deg: the axis paused or a clock "
                "jumped; sweep again"
            )
        return centre_s, float(middle), float(slope), clock_s

    def _read_times(self) -> tuple[Array, Bools, float]:
        """Times of joint readings (M,), in the cell's time, and which were answered promptly. With
        the standard uncertainty of all.
        """
        waited_s = np.ptp(self.asked_s, axis=1)
        if bool(np.all(np.isnan(self.stamped_s))):
            prompt = waited_s <= 4.0 * np.median(waited_s) + 1e-4
            return self.asked_s.mean(axis=1), prompt, 0.0
        offset_s, clock_s = _clock(self.stamped_s, self.asked_s)
        return self.stamped_s + offset_s, np.ones(len(waited_s), dtype=bool), clock_s

    def turned_rad(self, arm: Arm, axis: int) -> Array:
        """Angle (N,) of ``axis`` by the reflector's position on its nominal circle."""
        start_rad = np.median(self.joints_rad, axis=0)
        before = np.eye(4)
        for link in link_transforms(arm, start_rad)[:axis]:
            before = before @ link
        z, origin_mm = before[:3, 2], before[:3, 3]
        lever_mm = self.xyz_mm - origin_mm
        lever_mm = lever_mm - (lever_mm @ z)[:, None] * z
        nominal_mm = forward(arm, start_rad)[:3, 3] - origin_mm
        nominal_mm = nominal_mm - (nominal_mm @ z) * z
        radius_mm, found_mm = (
            np.linalg.norm(nominal_mm),
            np.median(np.linalg.norm(lever_mm, axis=1)),
        )
        if not abs(found_mm - radius_mm) <= self.RADIUS_MM:
            raise BadStream(
                f"the reflector runs {found_mm:.1f} mm from axis {axis + 1}, expected "
                f"{radius_mm:.1f} +-{self.RADIUS_MM:g} mm: "
                "units are not mm and rad, or another axis or reflector moved"
            )
        ahead = nominal_mm / radius_mm
        turned = np.arctan2(lever_mm @ np.cross(z, ahead), lever_mm @ ahead)
        return np.asarray(start_rad[axis] + arm.sign[axis] * turned)


@dataclass(frozen=True, slots=True)
class Motion:
    """The part at constant speed: N samples in order of time.

    ``joint_rad`` (N,): the axis by the controller's readings at each sample, except for the lag;
    ``error_rad`` (N,): additional rotation measured by the tracker; ``clock_s``: standard
    uncertainty of the relation between both clocks, apart from its lag.
    """

    joint_rad: Array
    error_rad: Array
    speed_rad_s: float  # below 0 downwards
    clock_s: float
    lost: int  # samples that never came, or were spikes


def axis_motion(stream: SweepStream, arm: Arm, axis: int) -> Motion:
    """Return the motion of ``axis`` (0 to 5) by its own angle; raises `BadStream`."""
    stream.check_numbers()
    stream, arm = replace(stream, joints_rad=arm.angles(stream.joints_rad)), arm.by_angles
    angle_rad = stream.turned_rad(arm, axis)
    inner = _between_ends(angle_rad)
    time_s, angle_rad = (stream.device_s - stream.device_s[0])[inner], angle_rad[inner]
    kept = _without_spikes(angle_rad)
    time_s, angle_rad = time_s[kept], angle_rad[kept]
    window_s = stream.window_s[inner][kept]
    _check_even(time_s, angle_rad)
    middle_s, middle_rad, speed_rad_s, read_s = stream.joint_line(axis, angle_rad)
    seen_rad_s = float(np.polyfit(time_s, angle_rad, 1)[0])
    scale = 0.01  # by which both speeds may differ
    if not abs(seen_rad_s / speed_rad_s - 1.0) <= scale:
        raise BadStream(
            f"the tracker sees the axis turn at {np.degrees(seen_rad_s):.4f} deg/s, the joints' "
            f"readings at {np.degrees(speed_rad_s):.4f} deg/s, expected equal within "
            f"{100 * scale:g} %: angles or times are in other units, or a stream is another's"
        )
    offset_s, clock_s = _clock(time_s, window_s)
    joint_rad = middle_rad + speed_rad_s * (time_s + offset_s - middle_s)
    separation_s = float(np.median(np.diff(time_s)))
    expected = round((time_s[-1] - time_s[0]) / separation_s) + 1
    lost = expected - len(time_s)
    lost_share = 0.25
    if not lost <= lost_share * expected:
        raise BadStream(
            f"{lost} of {expected} samples never came, expected <= {100 * lost_share:g} %: check "
            "the beam's path and the tracker's link"
        )
    clock_s = float(np.hypot(clock_s, read_s))
    return Motion(joint_rad, angle_rad - joint_rad, speed_rad_s, clock_s, lost)


def _between_ends(angle_rad: Array) -> slice:
    ends = np.array([np.median(angle_rad[:5]), np.median(angle_rad[-5:])])
    least_rotation_rad = 0.15
    if not abs(ends[1] - ends[0]) >= least_rotation_rad:
        raise BadStream(
            f"the axis turned by {np.degrees(ends[1] - ends[0]):.2f} deg, expected >= "
            f"{np.degrees(least_rotation_rad):.1f} deg: sweep further"
        )
    ramp_rad = float(np.radians(0.5))  # at each end, taken off with the ramps
    inner = np.flatnonzero(np.abs(angle_rad[:, None] - ends).min(axis=1) > ramp_rad)
    return slice(int(inner[0]), int(inner[-1]) + 1)


def _without_spikes(angle_rad: Array) -> Bools:
    """Which samples (N,) lie between their neighbours; many that do not are no spikes."""
    near = np.lib.stride_tricks.sliding_window_view(angle_rad, 5)
    off_rad = np.zeros(len(angle_rad))
    off_rad[2:-2] = np.abs(near[:, 2] - np.median(near[:, [0, 1, 3, 4]], axis=1))
    spike_sigma, spikes_share, least_spike_rad = 8.0, 0.02, 2e-5
    kept: Bools = off_rad <= spike_sigma * 1.48 * np.median(off_rad) + least_spike_rad
    if not np.mean(~kept) <= spikes_share:
        raise BadStream(
            f"{np.sum(~kept)} of {len(kept)} samples stand out from their neighbours, expected <= "
            f"{100 * spikes_share:g} %: the beam or the reflector is not steady"
        )
    return kept


def _check_even(time_s: Array, angle_rad: Array) -> None:
    """Refuse an axis that was slowed, and times that jump while the axis moves."""
    steps_s = np.diff(time_s)
    speed_rad_s = float(np.median(np.diff(angle_rad) / steps_s))
    unlike = 0.5  # share by which a step in time differs from the others
    jump_rad = 5e-4  # of the axis over a gap, against its speed: more than ripple turns it
    for n in np.flatnonzero(np.abs(steps_s / np.median(steps_s) - 1.0) > unlike):
        elapsed_s = (angle_rad[n + 1] - angle_rad[n]) / speed_rad_s
        if not abs(elapsed_s - steps_s[n]) * abs(speed_rad_s) <= jump_rad:
            raise BadStream(
                f"the tracker's time steps by {steps_s[n]:.3f} s after sample {n + 1}, while the "
                f"axis turns for {elapsed_s:.3f} s: its clock jumped, or the axis paused; sweep "
                "again"
            )
    window_s = 0.5  # over which a speed is judged
    ahead = np.searchsorted(time_s, time_s + window_s)
    first = np.flatnonzero(ahead < len(time_s))
    last = ahead[first]
    speeds = (angle_rad[last] - angle_rad[first]) / (time_s[last] - time_s[first])
    worst = int(np.argmax(np.abs(speeds / speed_rad_s - 1.0)))
    speed_share = 0.1  # by which it may miss the sweep's: ripple of 100 urad reaches 6 %
    if not abs(speeds[worst] / speed_rad_s - 1.0) <= speed_share:
        raise BadStream(
            f"the axis turned at {np.degrees(speeds[worst]):.3f} deg/s near "
            f"{np.degrees(angle_rad[first[worst]]):.2f} deg, at {np.degrees(speed_rad_s):.3f} "
            "deg/s elsewhere: it was slowed, or the tracker's clock jumped; sweep again"
        )


def _clock(time_s: Array, window_s: Array) -> tuple[float, float]:
    """Offset of the cell's clock from ``time_s``, and its standard uncertainty.

    A sample precedes its arrival: the quickest arrivals determine the offset. A clock error of 100
    ppm is negligible over a sweep.
    """
    late_s = window_s[:, 1] - time_s
    halves = np.array_split(late_s, 2)
    quickest_s = [float(half.min()) for half in halves]
    return float(np.mean(quickest_s)), abs(quickest_s[0] - quickest_s[1]) / 2.0
