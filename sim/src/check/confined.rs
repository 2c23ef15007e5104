//! Faults stay with the robot that they befall.

use sphere_protocol::robot::RobotId;

use super::Breach;
use crate::trace::Trace;

/// Where robots other than `faulty` differ between a run and the same one without the faults of `faulty`: the first row of each.
pub fn strayed(trace: &Trace, without: &Trace, faulty: RobotId) -> Vec<Breach> {
    let mut found: Vec<Breach> = Vec::new();
    for (row, twin) in trace.rows().iter().zip(without.rows()) {
        let is_new = found.iter().all(|breach| breach.robot != row.robot);
        if row.robot != faulty && is_new && !row.is_identical(twin) {
            found.push(Breach {
                rule: "faults-stay-confined",
                at: row.t,
                robot: row.robot,
            });
        }
    }
    found
}
