//! Real-time scheduling of the threads that must not be late.

use thiserror::Error;
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

/// The system does not let this program schedule in real time.
#[derive(Debug, Error)]
#[error(
    "no real-time scheduling ({why}): control may be late on a busy machine; give the program the capability CAP_SYS_NICE or an rtprio limit"
)]
pub struct Refused {
    why: String,
}

/// Puts the calling thread under SCHED_FIFO with `priority`, 1 to 99: it then runs before everything that is not in real time. For
/// threads that work briefly and sleep; one that never sleeps would stop the machine.
///
/// # Errors
/// The system refuses it: the thread goes on as before.
pub fn begin(priority: u8) -> Result<(), Refused> {
    let refused = |why: String| Refused { why };
    let value = ThreadPriorityValue::try_from(priority).map_err(|why| refused(why.to_owned()))?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|error| refused(format!("{error:?}")))
}

/// Of a robot's control loop.
pub const CONTROL: u8 = 50;
/// Of simulated plants: as a motor board they would run beside everything.
pub const PLANTS: u8 = 60;
