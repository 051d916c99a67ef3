"""A board that is none: what a robot measured becomes frames, and commands are carried out.

It does what `docs/board_protocol.md` asks of the firmware, and is the reference for it. Times are
nanoseconds since the start of what is played; only the frames tell board times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

from gyrocal_ros.board.clock import NS_PER_US
from gyrocal_ros.board.counts import imu_counts, supply_counts, wheel_counts
from gyrocal_ros.board.messages import Acknowledgement, CommandResult, Message, SetRates, Three, Wheels, Zero
from gyrocal_ros.board.protocol import Decoder, encode
from gyrocal_ros.config.sections import BoardConfig
from gyrocal_ros.data import (
    NS_PER_S,
    CovariateSample,
    ImuSample,
    Measurement,
    TemperatureSample,
    WheelSample,
    seconds,
)

LOOK_AHEAD_NS = 2 * NS_PER_S
"""So much of the beginning tells the rates of the sensors."""
POWER_ON_SUPPLY_HZ, MOST_SUPPLY_HZ = 10, 100
USUAL_TEMPERATURE_C = 25.0
"""Of a board without a thermometer."""
VOLTAGE, CURRENT = 'battery_state.voltage', 'battery_state.current'
NS_PER_MS = 1_000_000
NO_COUNTS: Three = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class Sensors:
    """What is behind the board, and what it reads at the start."""

    rates: SetRates
    """The highest that can be had; lower ones leave readings out."""
    temperature_c: float
    voltage_v: float
    current_a: float

    def can(self, asked: SetRates) -> bool:
        """Whether these rates can be had: a whole part of the highest, or none."""
        pairs = ((asked.imu, self.rates.imu), (asked.wheels, self.rates.wheels))
        return asked.supply <= self.rates.supply and all(
            rate == 0 or (most > 0 and most % rate == 0) for rate, most in pairs
        )


def look_ahead(measurements: Iterable[Measurement]) -> tuple[Sensors, Iterator[Measurement]]:
    """Tell the sensors by the first measurements, and return all of them, from the first one on."""
    left = iter(measurements)
    first: list[Measurement] = []
    for item in left:
        first.append(item)
        if item.t_ns - first[0].t_ns >= LOOK_AHEAD_NS:
            break
    begins: dict[str, float] = {}
    for item in reversed(first):
        if isinstance(item, TemperatureSample):
            begins['temperature'] = item.temperature_c
        elif isinstance(item, CovariateSample):
            begins[item.name] = item.value
    sensors = Sensors(
        SetRates(
            _rate_hz(item.t_ns for item in first if isinstance(item, ImuSample)),
            _rate_hz(item.t_ns for item in first if isinstance(item, WheelSample)),
            MOST_SUPPLY_HZ if VOLTAGE in begins else 0,
        ),
        begins.get('temperature', USUAL_TEMPERATURE_C),
        begins.get(VOLTAGE, 0.0),
        begins.get(CURRENT, 0.0),
    )
    return sensors, chain(first, left)


@dataclass(frozen=True, slots=True)
class Crystal:
    """The board's clock."""

    start_us: int = 0
    """What it reads at `since_ns`."""
    gain_ppm: float = 0.0
    """How much faster it runs than it should."""
    since_ns: int = 0

    def time_us(self, t_ns: int) -> int:
        """What it reads; only 32 bits of this are sent."""
        return self.start_us + round((t_ns - self.since_ns) * (1.0 + 1e-6 * self.gain_ppm) / NS_PER_US)


@dataclass(slots=True)
class Zeroing:
    """The zero of the gyros while it is being measured."""

    answers: int
    """Sequence number of the command."""
    until_ns: int
    wheels: Wheels
    """Where they stood when it began."""
    readings: list[Three] = field(default_factory=list)


class EmulatedBoard:
    """Sends what a robot's sensors read, as the rates ask for it.

    Args:
        config: what one count of each converter means.
        sensors: what is behind the board.
        crystal: its clock.
    """

    def __init__(self, config: BoardConfig, sensors: Sensors, crystal: Crystal) -> None:
        self._config, self._sensors = config, sensors
        self._zero = NO_COUNTS  # is kept when the power goes
        self._temperature_c = sensors.temperature_c
        self._supply = {VOLTAGE: sensors.voltage_v, CURRENT: sensors.current_a}
        self._start(crystal)

    def _start(self, crystal: Crystal) -> None:
        most = self._sensors.rates
        self._crystal = crystal
        self._rates = replace(most, supply=min(most.supply, POWER_ON_SUPPLY_HZ))
        self._sequence = 0
        self._readings: Counter[type[Measurement]] = Counter()
        self._distance_m, self._turned_rad = 0.0, 0.0
        self._rolled_ns: int | None = None
        self._supply_ns: int | None = None
        self._zeroing: Zeroing | None = None
        self._unknown: list[tuple[int, int]] = []
        self._decoder = Decoder(lambda kind, sequence: self._unknown.append((kind, sequence)))

    def restart(self, t_ns: int) -> None:
        """Lose the power and have it again."""
        self._start(replace(self._crystal, start_us=0, since_ns=t_ns))

    def measure(self, measurement: Measurement, t_ns: int) -> list[bytes]:
        """Let the sensors read, and return the frames that are to be sent of it, in their order."""
        if isinstance(measurement, ImuSample):
            return [*self._imu(measurement, t_ns), *self._supplied(t_ns), *self._zeroed(t_ns)]
        if isinstance(measurement, WheelSample):
            return self._rolled(measurement, t_ns)
        if isinstance(measurement, TemperatureSample):
            self._temperature_c = measurement.temperature_c
        elif isinstance(measurement, CovariateSample) and measurement.name in self._supply:
            self._supply[measurement.name] = measurement.value
        return []

    def hear(self, data: bytes, t_ns: int) -> list[bytes]:
        """Take the next bytes from the host, and return the answers."""
        frames = []
        for packet in self._decoder.feed(data):
            result = self._obey(packet.message, packet.sequence, t_ns)
            if result is not None:
                frames.append(self._answer(packet.sequence, packet.message.TYPE, result, t_ns))
        for kind, sequence in self._unknown:
            frames.append(self._answer(sequence, kind, CommandResult.UNKNOWN, t_ns))
        self._unknown.clear()
        return frames

    def _imu(self, sample: ImuSample, t_ns: int) -> Iterator[bytes]:
        counts = imu_counts(sample, self._temperature_c, self._config)
        if self._zeroing:
            self._zeroing.readings.append(counts.gyro)
        if self._is_chosen(ImuSample, self._sensors.rates.imu, self._rates.imu):
            yield self._frame(replace(counts, gyro=_less(counts.gyro, self._zero)), t_ns)

    def _rolled(self, sample: WheelSample, t_ns: int) -> list[bytes]:
        """Count on; a sample is the mean over the time since the one before."""
        usual_ns = NS_PER_S // max(self._sensors.rates.wheels, 1)
        duration_s = seconds(usual_ns if self._rolled_ns is None else t_ns - self._rolled_ns)
        self._rolled_ns = t_ns
        self._distance_m += sample.speed_m_s * duration_s
        self._turned_rad += sample.yaw_rate_rad_s * duration_s
        if not self._is_chosen(WheelSample, self._sensors.rates.wheels, self._rates.wheels):
            return []
        return [self._frame(self._wheels(), t_ns)]

    def _supplied(self, t_ns: int) -> Iterator[bytes]:
        """Send the supply when it is due; between two readings of it the last one holds."""
        if not self._rates.supply:
            return
        if self._supply_ns is None or t_ns >= self._supply_ns:
            period_ns = NS_PER_S // self._rates.supply
            self._supply_ns = t_ns - t_ns % period_ns + period_ns
            yield self._frame(supply_counts(self._supply[VOLTAGE], self._supply[CURRENT]), t_ns)

    def _zeroed(self, t_ns: int) -> Iterator[bytes]:
        """Finish the zero when its time is over."""
        zeroing = self._zeroing
        if zeroing is None or t_ns < zeroing.until_ns:
            return
        self._zeroing = None
        result = CommandResult.REFUSED
        if zeroing.readings and zeroing.wheels == self._wheels():
            self._zero, result = _mean(zeroing.readings), CommandResult.DONE
        yield self._answer(zeroing.answers, Zero.TYPE, result, t_ns)

    def _obey(self, message: Message, sequence: int, t_ns: int) -> CommandResult | None:
        """Carry a command out; None where the answer comes later, or what came is none."""
        if isinstance(message, SetRates):
            if not self._sensors.can(message):
                return CommandResult.OUT_OF_RANGE
            self._rates, self._supply_ns = message, None
            return CommandResult.DONE
        if isinstance(message, Zero):
            self._zeroing = Zeroing(sequence, t_ns + message.duration * NS_PER_MS, self._wheels())
        return None

    def _wheels(self) -> Wheels:
        return wheel_counts(self._distance_m, self._turned_rad, self._config)

    def _is_chosen(self, kind: type[Measurement], most_hz: int, rate_hz: int) -> bool:
        """Whether a reading is one of those to send."""
        self._readings[kind] += 1
        return rate_hz > 0 and self._readings[kind] % max(most_hz // rate_hz, 1) == 0

    def _answer(self, sequence: int, command: int, result: CommandResult, t_ns: int) -> bytes:
        return self._frame(Acknowledgement(sequence, command, result), t_ns)

    def _frame(self, message: Message, t_ns: int) -> bytes:
        frame = encode(message, self._sequence, self._crystal.time_us(t_ns))
        # Empty frames mean nothing; this one keeps noise of the power-on off the first.
        start = b'' if self._sequence else b'\0'
        self._sequence += 1
        return start + frame


def _rate_hz(times_ns: Iterable[int]) -> int:
    """The rate of some times, 0 where there are fewer than two."""
    times = list(times_ns)
    return round((len(times) - 1) / seconds(times[-1] - times[0])) if len(times) > 1 else 0


def _mean(readings: list[Three]) -> Three:
    x, y, z = (round(sum(axis) / len(readings)) for axis in zip(*readings, strict=True))
    return x, y, z


def _less(counts: Three, zero: Three) -> Three:
    x, y, z = (count - offset for count, offset in zip(counts, zero, strict=True))
    return x, y, z
