//! The instances as files that `sphere-ground plan` and the Python side read.

use std::fs;
use std::path::Path;

use anyhow::Context;
use serde_json::{Value, json};
use sphere_ground::mpc::{FirstInput, Problem};

use crate::instances::{self, Trajectory};

/// Sets that are compared.
const HORIZONS: [usize; 2] = [10, 20];

/// Writes every set along every trajectory into `folder`.
pub fn write_all(folder: &Path) -> anyhow::Result<()> {
    for trajectory in Trajectory::ALL {
        let name = trajectory.name();
        write(
            folder,
            &format!("paper-{name}"),
            &instances::paper(trajectory),
        )?;
        for horizon in HORIZONS {
            let problems = instances::lag(trajectory, horizon);
            write(folder, &format!("lag-{horizon}-{name}"), &problems)?;
        }
    }
    Ok(())
}

fn write<const NX: usize>(
    folder: &Path,
    name: &str,
    problems: &[Problem<NX>],
) -> anyhow::Result<()> {
    let instances: Vec<Value> = problems
        .iter()
        .enumerate()
        .map(|(id, p)| instance(id, p))
        .collect();
    let file = folder.join(format!("{name}.json"));
    let text = serde_json::to_string(&json!({
        "note": "closed-loop instances, one a tick of 0.1 s; the turn limit, which never binds here, is left out",
        "instances": instances,
    }))?;
    fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
}

/// One problem in the format of `sphere-ground plan`.
fn instance<const NX: usize>(id: usize, problem: &Problem<NX>) -> Value {
    let rows = |i: usize, j: usize| problem.p_terminal[(i, j)];
    let terminal: Vec<Vec<f64>> = (0..NX)
        .map(|i| (0..NX).map(|j| rows(i, j)).collect())
        .collect();
    json!({
        "id": id,
        "kind": if problem.first_input == FirstInput::Measured { "paper" } else { "centre" },
        "n_x": NX,
        "horizon_n": problem.horizon(),
        "dt_s": problem.model.period(),
        "sphere_radius_m": problem.model.radius(),
        "lag_tau_s": if NX == 5 { json!(LAG) } else { Value::Null },
        "x0_m_m_rad_mps_rad": problem.x0.as_slice(),
        "u_prev_mps_rad": problem.u_prev.as_slice(),
        "xref_1_to_n_m_m_rad_mps_rad": problem.x_ref.iter().map(|x| x.as_slice()).collect::<Vec<_>>(),
        "uref_mps_rad": problem.u_ref.iter().map(|u| u.as_slice()).collect::<Vec<_>>(),
        "q_diag_per_m2_m2_rad2_mps2_rad2": problem.q.as_slice(),
        "p_terminal_matrix": terminal,
        "r_diag_per_mps2_rad2": problem.r.as_slice(),
        "u_min_mps_rad": problem.u_min[0].as_slice(),
        "u_max_mps_rad": problem.u_max[0].as_slice(),
    })
}

/// Reference lag of the robot `liu` [s].
const LAG: f64 = 0.4;
