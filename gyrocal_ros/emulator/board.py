"""Emulation of the board: converts measurements to frames and executes commands.

It is the reference implementation of the firmware that `docs/board_protocol.md` specifies. Times are
nanoseconds since the start of the recording; only frames contain board times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

from gyrocal_ros.board.clock import NS_PER_US
from gyrocal_ros.board.counts import imu_counts, supply_counts, wheel_counts
from gyrocal_ros.board.messages import (
    Acknowledgement,
    CommandResult,
    IntTriple,
    Message,
    SetRates,
    Wheels,
    Zero,
)
from gyrocal_ros.board.protocol import Decoder, encode
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import (
    NS_PER_S,
    CovariateSample,
    ImuSample,
    Measurement,
    TemperatureSample,
    WheelSample,
    seconds,
)

DETECTION_NS = 2 * NS_PER_S
"""Length of the beginning of a recording from which the sensor rates are detected."""
POWER_ON_SUPPLY_HZ, MAX_SUPPLY_HZ = 10, 100
DEFAULT_TEMPERATURE_C = 25.0
"""Temperature of a board without a thermometer."""
VOLTAGE, CURRENT = 'battery_state.voltage', 'battery_state.current'
NS_PER_MS = 1_000_000
ZERO_COUNTS: IntTriple = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class SensorSetup:
    """Rates of the sensors behind the board and their first readings."""

    rates: SetRates
    """Highest available rates; at lower rates readings are skipped."""
    temperature_c: float
    voltage_v: float
    current_a: float

    def supports(self, requested: SetRates) -> bool:
        """Return whether each rate is 0 or the highest one divided by an integer."""
        pairs = ((requested.imu, self.rates.imu), (requested.wheels, self.rates.wheels))
        return requested.supply <= self.rates.supply and all(
            rate == 0 or (maximum > 0 and maximum % rate == 0) for rate, maximum in pairs
        )


def detect_sensors(measurements: Iterable[Measurement]) -> tuple[SensorSetup, Iterator[Measurement]]:
    """Detect the sensors from the first measurements.

    Returns:
        The sensors, and an iterator over all measurements including the first ones.
    """
    left = iter(measurements)
    first: list[Measurement] = []
    for item in left:
        first.append(item)
        if item.t_ns - first[0].t_ns >= DETECTION_NS:
            break
    initial: dict[str, float] = {}
    for item in reversed(first):
        if isinstance(item, TemperatureSample):
            initial['temperature'] = item.temperature_c
        elif isinstance(item, CovariateSample):
            initial[item.name] = item.value
    sensors = SensorSetup(
        SetRates(
            _rate_hz(item.t_ns for item in first if isinstance(item, ImuSample)),
            _rate_hz(item.t_ns for item in first if isinstance(item, WheelSample)),
            MAX_SUPPLY_HZ if VOLTAGE in initial else 0,
        ),
        initial.get('temperature', DEFAULT_TEMPERATURE_C),
        initial.get(VOLTAGE, 0.0),
        initial.get(CURRENT, 0.0),
    )
    return sensors, chain(first, left)


@dataclass(frozen=True, slots=True)
class Oscillator:
    """Clock of the emulated board."""

    start_us: int = 0
    """Reading of the clock at `since_ns`."""
    drift_ppm: float = 0.0
    """Rate error of the clock; positive if it runs fast."""
    since_ns: int = 0

    def time_us(self, t_ns: int) -> int:
        """Return the reading of the clock; only 32 bits of it are transmitted."""
        return self.start_us + round((t_ns - self.since_ns) * (1.0 + 1e-6 * self.drift_ppm) / NS_PER_US)


@dataclass(slots=True)
class ZeroMeasurement:
    """A running measurement of the gyro zeros."""

    sequence: int
    """Sequence number of the command."""
    until_ns: int
    wheels: Wheels
    """Tick counters at the start of the measurement."""
    readings: list[IntTriple] = field(default_factory=list)


class EmulatedBoard:
    """Converts the readings of a robot's sensors to frames at the requested rates.

    Args:
        config: meaning of one count of each converter.
        sensors: the sensors behind the board.
        oscillator: clock of the board.
    """

    def __init__(self, config: BoardConfig, sensors: SensorSetup, oscillator: Oscillator) -> None:
        self._config, self._sensors = config, sensors
        self._zero = ZERO_COUNTS  # non-volatile: survives a loss of power
        self._temperature_c = sensors.temperature_c
        self._supply = {VOLTAGE: sensors.voltage_v, CURRENT: sensors.current_a}
        self._start(oscillator)

    def _start(self, oscillator: Oscillator) -> None:
        maximum = self._sensors.rates
        self._oscillator = oscillator
        self._rates = replace(maximum, supply=min(maximum.supply, POWER_ON_SUPPLY_HZ))
        self._sequence = 0
        self._readings: Counter[type[Measurement]] = Counter()
        self._distance_m, self._turned_rad = 0.0, 0.0
        self._wheels_ns: int | None = None
        self._supply_ns: int | None = None
        self._zero_measurement: ZeroMeasurement | None = None
        self._unknown: list[tuple[int, int]] = []
        self._decoder = Decoder(lambda kind, sequence: self._unknown.append((kind, sequence)))

    def restart(self, t_ns: int) -> None:
        """Restart after a loss of power."""
        self._start(replace(self._oscillator, start_us=0, since_ns=t_ns))

    def measure(self, measurement: Measurement, t_ns: int) -> list[bytes]:
        """Process a sensor reading and return the frames to be sent, in order."""
        if isinstance(measurement, ImuSample):
            return [*self._imu(measurement, t_ns), *self._due_supply(t_ns), *self._finished_zero(t_ns)]
        if isinstance(measurement, WheelSample):
            return self._count_ticks(measurement, t_ns)
        if isinstance(measurement, TemperatureSample):
            self._temperature_c = measurement.temperature_c
        elif isinstance(measurement, CovariateSample) and measurement.name in self._supply:
            self._supply[measurement.name] = measurement.value
        return []

    def receive(self, data: bytes, t_ns: int) -> list[bytes]:
        """Process the next bytes from the host and return the answers."""
        frames = []
        for packet in self._decoder.feed(data):
            result = self._execute(packet.message, packet.sequence, t_ns)
            if result is not None:
                frames.append(self._answer(packet.sequence, packet.message.TYPE, result, t_ns))
        for kind, sequence in self._unknown:
            frames.append(self._answer(sequence, kind, CommandResult.UNKNOWN, t_ns))
        self._unknown.clear()
        return frames

    def _imu(self, sample: ImuSample, t_ns: int) -> Iterator[bytes]:
        counts = imu_counts(sample, self._temperature_c, self._config)
        if self._zero_measurement:
            self._zero_measurement.readings.append(counts.gyro)
        if self._is_kept(ImuSample, self._sensors.rates.imu, self._rates.imu):
            yield self._frame(replace(counts, gyro=_minus(counts.gyro, self._zero)), t_ns)

    def _count_ticks(self, sample: WheelSample, t_ns: int) -> list[bytes]:
        """Advance the tick counters; a sample is the mean speed since the previous one."""
        nominal_ns = NS_PER_S // max(self._sensors.rates.wheels, 1)
        duration_s = seconds(nominal_ns if self._wheels_ns is None else t_ns - self._wheels_ns)
        self._wheels_ns = t_ns
        self._distance_m += sample.speed_m_s * duration_s
        self._turned_rad += sample.yaw_rate_rad_s * duration_s
        if not self._is_kept(WheelSample, self._sensors.rates.wheels, self._rates.wheels):
            return []
        return [self._frame(self._wheels(), t_ns)]

    def _due_supply(self, t_ns: int) -> Iterator[bytes]:
        """Send the supply when it is due; between two readings the last value is held."""
        if not self._rates.supply:
            return
        if self._supply_ns is None or t_ns >= self._supply_ns:
            period_ns = NS_PER_S // self._rates.supply
            self._supply_ns = t_ns - t_ns % period_ns + period_ns
            yield self._frame(supply_counts(self._supply[VOLTAGE], self._supply[CURRENT]), t_ns)

    def _finished_zero(self, t_ns: int) -> Iterator[bytes]:
        """Finish the measurement of the zeros after its averaging time."""
        zero = self._zero_measurement
        if zero is None or t_ns < zero.until_ns:
            return
        self._zero_measurement = None
        result = CommandResult.REFUSED
        if zero.readings and zero.wheels == self._wheels():
            self._zero, result = _mean(zero.readings), CommandResult.DONE
        yield self._answer(zero.sequence, Zero.TYPE, result, t_ns)

    def _execute(self, message: Message, sequence: int, t_ns: int) -> CommandResult | None:
        """Execute a command; return None if it is answered later or is not a command."""
        if isinstance(message, SetRates):
            if not self._sensors.supports(message):
                return CommandResult.OUT_OF_RANGE
            self._rates, self._supply_ns = message, None
            return CommandResult.DONE
        if isinstance(message, Zero):
            self._zero_measurement = ZeroMeasurement(
                sequence, t_ns + message.duration * NS_PER_MS, self._wheels()
            )
        return None

    def _wheels(self) -> Wheels:
        return wheel_counts(self._distance_m, self._turned_rad, self._config)

    def _is_kept(self, kind: type[Measurement], max_hz: int, rate_hz: int) -> bool:
        """Return whether a reading is to be sent."""
        self._readings[kind] += 1
        return rate_hz > 0 and self._readings[kind] % max(max_hz // rate_hz, 1) == 0

    def _answer(self, sequence: int, command: int, result: CommandResult, t_ns: int) -> bytes:
        return self._frame(Acknowledgement(sequence, command, result), t_ns)

    def _frame(self, message: Message, t_ns: int) -> bytes:
        frame = encode(message, self._sequence, self._oscillator.time_us(t_ns))
        # An empty frame before the first one separates it from noise of the power-on.
        start = b'' if self._sequence else b'\0'
        self._sequence += 1
        return start + frame


def _rate_hz(times_ns: Iterable[int]) -> int:
    """Return the mean rate of some times, 0 if there are fewer than two."""
    times = list(times_ns)
    return round((len(times) - 1) / seconds(times[-1] - times[0])) if len(times) > 1 else 0


def _mean(readings: list[IntTriple]) -> IntTriple:
    x, y, z = (round(sum(axis) / len(readings)) for axis in zip(*readings, strict=True))
    return x, y, z


def _minus(counts: IntTriple, zero: IntTriple) -> IntTriple:
    x, y, z = (count - offset for count, offset in zip(counts, zero, strict=True))
    return x, y, z
