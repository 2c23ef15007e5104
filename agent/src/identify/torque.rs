//! What reaches the joints of the torques that were commanded.

use sphere_protocol::state::Torque;

use super::log::{Sample, TorqueAt};

/// Mean torque (pitch, roll) between each two samples [N·m]: commands held, `delay` [s] late, through a first-order `lag` [s].
pub(super) fn mean_torques(
    samples: &[Sample],
    commands: &[TorqueAt],
    delay: f64,
    lag: f64,
) -> Vec<[f64; 2]> {
    let mut commands = commands.iter().peekable();
    let (mut target, mut torque) = ([0.0; 2], [0.0; 2]);
    samples
        .windows(2)
        .map(|pair| {
            let (mut at, end) = (pair[0].at, pair[1].at);
            let mut impulse = [0.0; 2];
            loop {
                let next = commands.peek().map_or(end, |c| (c.at + delay).min(end));
                if next > at {
                    hold(&mut torque, target, next - at, lag, &mut impulse);
                    at = next;
                }
                match commands.peek() {
                    Some(command) if command.at + delay < end => {
                        let Torque { pitch, roll } = command.torque;
                        target = [pitch, roll];
                        commands.next();
                    }
                    _ => break,
                }
            }
            impulse.map(|impulse| impulse / (end - pair[0].at))
        })
        .collect()
}

/// `target` held for `dt` [s]; the torque's integral is added to `impulse` [N·m·s].
fn hold(torque: &mut [f64; 2], target: [f64; 2], dt: f64, lag: f64, impulse: &mut [f64; 2]) {
    let left = if lag > 0.0 { (-dt / lag).exp() } else { 0.0 };
    for axis in 0..2 {
        let behind = torque[axis] - target[axis];
        impulse[axis] += target[axis] * dt + behind * lag * (1.0 - left);
        torque[axis] = target[axis] + behind * left;
    }
}
