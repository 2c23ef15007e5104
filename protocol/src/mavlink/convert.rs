//! Our types to MAVLink's messages and back. Values are checked both ways: NaN passes MAVLink's own parser.

use super::sphere::{
    HEARTBEAT_DATA, MavModeFlag, SPHERE_SENSORS_DATA, SPHERE_TORQUE_DATA, SphereBoardStatus,
    VISION_POSITION_ESTIMATE_DATA,
};
use super::{
    Address, Event, Heartbeat, MavMessage, TORQUE_SANE, TorqueCommand, VALIDITY_MAX, ValueError,
};
use crate::state::{BoardStatus, Measurement, PositionFix, Torque};
use crate::time::{BoardClock, Instant, Span};

/// What `message` says.
///
/// # Errors
/// A value that is not finite or out of range.
pub(super) fn event(message: MavMessage) -> Result<Event, ValueError> {
    Ok(match message {
        MavMessage::SPHERE_SENSORS(data) => Event::Sensors {
            measurement: sensors(&data)?,
            sequence: data.sequence,
        },
        MavMessage::SPHERE_TORQUE(data) => Event::Torque(torque(&data)?),
        MavMessage::VISION_POSITION_ESTIMATE(data) => Event::Fix(fix(&data)?),
        MavMessage::HEARTBEAT(data) => Event::Heartbeat(heartbeat(&data)),
        other => Event::Other(other),
    })
}

pub(super) fn from_sensors(sample: &Measurement, sequence: u32) -> Result<MavMessage, ValueError> {
    let data = SPHERE_SENSORS_DATA {
        time_usec: usec(SENSORS, sample.stamp)?,
        theta_r: sample.theta_r,
        theta_p: sample.theta_p,
        theta_r_rate: sample.theta_r_rate as f32,
        theta_p_rate: sample.theta_p_rate as f32,
        gyro: sample.gyro.map(|value| value as f32),
        accel: sample.accel.map(|value| value as f32),
        sequence,
        status: status_bits(&sample.status),
    };
    sensors(&data)?;
    Ok(MavMessage::SPHERE_SENSORS(data))
}

fn sensors(data: &SPHERE_SENSORS_DATA) -> Result<Measurement, ValueError> {
    let measurement = Measurement {
        stamp: stamp(SENSORS, data.time_usec)?,
        gyro: data.gyro.map(f64::from),
        accel: data.accel.map(f64::from),
        theta_r: data.theta_r,
        theta_r_rate: f64::from(data.theta_r_rate),
        theta_p: data.theta_p,
        theta_p_rate: f64::from(data.theta_p_rate),
        status: BoardStatus {
            torque_on: data.status.contains(TORQUE_ON),
            command_valid: data.status.contains(COMMAND_VALID),
            imu_ok: data.status.contains(IMU_OK),
            encoders_ok: data.status.contains(ENCODERS_OK),
        },
    };
    let m = &measurement;
    finite(SENSORS, "gyro", &m.gyro)?;
    finite(SENSORS, "accel", &m.accel)?;
    finite(SENSORS, "theta_r", &[m.theta_r, m.theta_r_rate])?;
    finite(SENSORS, "theta_p", &[m.theta_p, m.theta_p_rate])?;
    Ok(measurement)
}

pub(super) fn from_torque(command: &TorqueCommand) -> Result<MavMessage, ValueError> {
    let in_range = command.validity > Span::ZERO && command.validity <= VALIDITY_MAX;
    check(TORQUE, "validity_ms", "1 to 1000", in_range)?;
    let data = SPHERE_TORQUE_DATA {
        target_system: command.target.system,
        target_component: command.target.component,
        sequence: command.sequence,
        torque_pitch: command.torque.pitch as f32,
        torque_roll: command.torque.roll as f32,
        // Rounded down: never followed for longer than was meant.
        validity_ms: (command.validity.as_nanos() / NS_PER_MS) as u16,
    };
    torque(&data)?;
    Ok(MavMessage::SPHERE_TORQUE(data))
}

fn torque(data: &SPHERE_TORQUE_DATA) -> Result<TorqueCommand, ValueError> {
    let command = TorqueCommand {
        target: Address {
            system: data.target_system,
            component: data.target_component,
        },
        sequence: data.sequence,
        torque: Torque {
            pitch: f64::from(data.torque_pitch),
            roll: f64::from(data.torque_roll),
        },
        validity: Span::from_millis(i64::from(data.validity_ms)),
    };
    // A comparison with NaN is false.
    let sane = |torque: f64| torque.abs() <= TORQUE_SANE;
    check(
        TORQUE,
        "target_system",
        "one system",
        command.target.system != 0,
    )?;
    check(
        TORQUE,
        "torque_pitch",
        "within ±200 N·m",
        sane(command.torque.pitch),
    )?;
    check(
        TORQUE,
        "torque_roll",
        "within ±200 N·m",
        sane(command.torque.roll),
    )?;
    let in_range = command.validity > Span::ZERO && command.validity <= VALIDITY_MAX;
    check(TORQUE, "validity_ms", "1 to 1000", in_range)?;
    Ok(command)
}

pub(super) fn from_fix(fix: &PositionFix) -> Result<MavMessage, ValueError> {
    let variance = (fix.sigma * fix.sigma) as f32;
    let mut covariance = [f32::NAN; 21];
    (covariance[VAR_X], covariance[COV_XY], covariance[VAR_Y]) = (variance, 0.0, variance);
    let data = VISION_POSITION_ESTIMATE_DATA {
        usec: usec(FIX, fix.stamp)?,
        // ENU to NED.
        x: fix.y as f32,
        y: fix.x as f32,
        z: 0.0,
        roll: f32::NAN,
        pitch: f32::NAN,
        yaw: f32::NAN,
        covariance,
        reset_counter: 0,
    };
    self::fix(&data)?;
    Ok(MavMessage::VISION_POSITION_ESTIMATE(data))
}

/// The larger axis counts as the standard deviation of both. A fix without covariance is refused: it could not be weighed.
fn fix(data: &VISION_POSITION_ESTIMATE_DATA) -> Result<PositionFix, ValueError> {
    let (var_x, var_y) = (data.covariance[VAR_X], data.covariance[VAR_Y]);
    let known = |variance: f32| variance.is_finite() && variance > 0.0;
    check(
        FIX,
        "covariance",
        "finite and > 0 for x and y",
        known(var_x) && known(var_y),
    )?;
    let fix = PositionFix {
        stamp: stamp(FIX, data.usec)?,
        // NED to ENU.
        x: f64::from(data.y),
        y: f64::from(data.x),
        sigma: f64::from(var_x.max(var_y)).sqrt(),
    };
    finite(FIX, "x, y", &[fix.x, fix.y])?;
    Ok(fix)
}

pub(super) fn from_heartbeat(heartbeat: &Heartbeat) -> MavMessage {
    let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
    base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, heartbeat.armed);
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: heartbeat.custom_mode,
        mavtype: heartbeat.kind,
        autopilot: heartbeat.autopilot,
        base_mode,
        system_status: heartbeat.state,
        mavlink_version: MAVLINK_VERSION,
    })
}

fn heartbeat(data: &HEARTBEAT_DATA) -> Heartbeat {
    Heartbeat {
        kind: data.mavtype,
        autopilot: data.autopilot,
        armed: data
            .base_mode
            .contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED),
        state: data.system_status,
        custom_mode: data.custom_mode,
    }
}

fn status_bits(status: &BoardStatus) -> SphereBoardStatus {
    let mut bits = SphereBoardStatus::empty();
    bits.set(TORQUE_ON, status.torque_on);
    bits.set(COMMAND_VALID, status.command_valid);
    bits.set(IMU_OK, status.imu_ok);
    bits.set(ENCODERS_OK, status.encoders_ok);
    bits
}

/// Whole microseconds of the board's clock, rounded down.
fn usec(message: &'static str, stamp: Instant<BoardClock>) -> Result<u64, ValueError> {
    u64::try_from(stamp.as_nanos().div_euclid(NS_PER_US)).map_err(|_| stamp_error(message))
}

fn stamp(message: &'static str, usec: u64) -> Result<Instant<BoardClock>, ValueError> {
    let ns = i64::try_from(usec)
        .ok()
        .and_then(|us| us.checked_mul(NS_PER_US));
    ns.map(Instant::from_nanos).ok_or(stamp_error(message))
}

fn stamp_error(message: &'static str) -> ValueError {
    ValueError {
        message,
        field: "usec",
        must: "after the clock's origin and within 292 years of it",
    }
}

fn finite(message: &'static str, field: &'static str, values: &[f64]) -> Result<(), ValueError> {
    check(
        message,
        field,
        "finite",
        values.iter().all(|value| value.is_finite()),
    )
}

fn check(
    message: &'static str,
    field: &'static str,
    must: &'static str,
    holds: bool,
) -> Result<(), ValueError> {
    if holds {
        Ok(())
    } else {
        Err(ValueError {
            message,
            field,
            must,
        })
    }
}

const SENSORS: &str = "SPHERE_SENSORS";
const TORQUE: &str = "SPHERE_TORQUE";
const FIX: &str = "VISION_POSITION_ESTIMATE";

const TORQUE_ON: SphereBoardStatus = SphereBoardStatus::SPHERE_BOARD_STATUS_TORQUE_ON;
const COMMAND_VALID: SphereBoardStatus = SphereBoardStatus::SPHERE_BOARD_STATUS_COMMAND_VALID;
const IMU_OK: SphereBoardStatus = SphereBoardStatus::SPHERE_BOARD_STATUS_IMU_OK;
const ENCODERS_OK: SphereBoardStatus = SphereBoardStatus::SPHERE_BOARD_STATUS_ENCODERS_OK;

// Places in the upper right triangle of the pose's covariance, row by row.
const VAR_X: usize = 0;
const COV_XY: usize = 1;
const VAR_Y: usize = 6;

/// What HEARTBEAT states of either version of the protocol.
const MAVLINK_VERSION: u8 = 3;

const NS_PER_US: i64 = 1_000;
const NS_PER_MS: i64 = 1_000_000;
