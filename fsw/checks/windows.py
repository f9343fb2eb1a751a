"""Check the windows of a configuration: number of samples, and lag."""

from operator import itemgetter

from fsw.checks import budget
from fsw.config import Config
from fsw.estimators.conditioning.polynomial import EXTRA_DEGREE

MIN_WINDOW_SAMPLES = 8  # least samples of each channel in a window
MAX_WINDOW_SAMPLES = 20_000  # most samples of the fastest channel: a window is one polynomial


def window_faults(config: Config) -> list[str]:
    """Return the faults of a window: too few or too many samples, or less than a tick."""
    estimator = config.estimator
    position_terms = estimator.nodes + EXTRA_DEGREE
    channels = [
        (f"buses.{i}.rate_hz", bus.rate_hz, 2 * position_terms)
        for i, bus in enumerate(config.buses)
    ]
    channels.append(("imu.rate_hz", config.imu.rate_hz, 2 * estimator.nodes))
    channels += [
        (f"wrench_sensors.{i}.rate_hz", sensor.rate_hz, 2 * estimator.nodes)
        for i, sensor in enumerate(config.wrench_sensors)
    ]
    rates_hz = {key: rate_hz for key, rate_hz, _ in channels}
    for section, actuators in config.actuators.items():
        rates_hz |= {f"{section}.{i}.rate_hz": own.rate_hz for i, own in enumerate(actuators)}
    fastest, rate_hz = max(rates_hz.items(), key=itemgetter(1))
    faults = []
    if estimator.window_s * rate_hz > MAX_WINDOW_SAMPLES:
        faults.append(
            f"estimator.window_s: {estimator.window_s:g} has {estimator.window_s * rate_hz:.0f} "
            f"samples at {fastest} {rate_hz:g}; must be at most {MAX_WINDOW_SAMPLES / rate_hz:.4g} "
            f"({MAX_WINDOW_SAMPLES} samples)"
        )
    for key, rate_hz, needed in channels:
        samples = rate_hz * estimator.window_s
        if samples < MIN_WINDOW_SAMPLES:
            faults.append(
                f"{key}: {rate_hz:g} gives {samples:.1f} samples in estimator.window_s "
                f"{estimator.window_s:g}; at least {MIN_WINDOW_SAMPLES} are needed"
            )
        elif samples * estimator.min_fill_ratio < needed:
            faults.append(
                f"{key}: {rate_hz:g} gives {samples:.1f} samples in estimator.window_s "
                f"{estimator.window_s:g}, of which estimator.min_fill_ratio "
                f"{estimator.min_fill_ratio:g} must be at least {needed}, twice the terms of the "
                f"polynomial for estimator.nodes {estimator.nodes}"
            )
    period_s = 1.0 / config.scheduler.tick_rate_hz
    if estimator.window_s < period_s:
        faults.append(
            f"estimator.window_s: {estimator.window_s:g} must be at least one tick, {period_s:g}"
        )
    return faults


def lag_faults(config: Config) -> list[str]:
    """Return a line for each sensor whose samples arrive after the window has closed."""
    scheduler, lag_s = config.scheduler, config.estimator.lag_s
    delays = {
        f"joints on buses.{i} (one cycle, the kernel's queues, one tick)": budget.joint_delay_s(
            bus, scheduler
        )
        for i, bus in enumerate(config.buses)
    }
    delays["imu (group delay, one sample, the line, one tick)"] = budget.imu_delay_s(
        config.imu, scheduler
    )
    if config.star_tracker is not None:
        delays["star_tracker (latency, the line, one tick)"] = budget.star_tracker_delay_s(
            config.star_tracker, scheduler
        )
    delays |= {
        f"{section}.{i} with its delay_s {own.late_s:g}": budget.actuator_delay_s(own, config)
        for section, actuators in config.actuators.items()
        for i, own in enumerate(actuators)
        if own.late_s
    }
    delays |= {
        f"wrench_sensors.{i} with its delay_s {sensor.delay_s:g}": sensor.delay_s
        for i, sensor in enumerate(config.wrench_sensors)
    }
    return [
        f"estimator.lag_s: {lag_s:g} is shorter than the delay of {source}; must be at least "
        f"{delay_s:.6f}"
        for source, delay_s in delays.items()
        if lag_s < delay_s
    ]
