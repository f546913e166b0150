//! What trackers write where they have lost their sensor.

use super::Expected::{Good, Told};
use super::{Case, case, hold};
use crate::program::Sandbox;
use crate::recordings::tracked;

/// The ride's poses and readings as files, in `lab`.
pub fn ride() -> Sandbox {
    let sandbox = tracked(|_, _| ());
    std::fs::rename(sandbox.join("ride"), sandbox.join("lab")).unwrap();
    sandbox
}

/// The table of poses with the position in these rows as `position` makes it of what stands there.
fn lost(rows: &'static [usize], position: impl Fn(&str) -> String + 'static) -> impl Fn(&Sandbox) + 'static {
    move |sandbox| {
        let row = |(k, line): (usize, &str)| {
            let fields: Vec<&str> = line.splitn(6, ',').collect();
            match k.checked_sub(1).filter(|k| rows.contains(k)) {
                Some(_) => format!("{},{},{},{}\n", fields[0], fields[1], position(&fields[2..5].join(",")), fields[5]),
                None => format!("{line}\n"),
            }
        };
        let table: String = sandbox.read("lab/tip.csv").lines().enumerate().map(row).collect();
        sandbox.write("lab/tip.csv", &table);
    }
}

fn gross(name: &'static str, to: &'static str, said: &'static str) -> Case {
    case(name, lost(&[17], move |_| to.to_owned()), Good(said))
}

#[test]
fn a_lost_sensor_costs_its_poses_and_does_not_turn_the_registration_over() {
    const LOST: &str = "1 of 49 poses have no position";
    const JUMP: &str = "1 of 49 poses lie off what the tip can reach";
    hold(
        ride,
        vec![
            gross("zeros", "0,0,0", LOST),
            gross("zeros with decimals", "0.000,0.000,0.000", LOST),
            gross("-9999", "-9999,-9999,-9999", LOST),
            gross("the largest negative float of NDI's files", "-3.697314e28,-3.697314e28,-3.697314e28", LOST),
            gross("NaN", "NaN,NaN,NaN", LOST),
            gross("nothing", ",,", LOST),
            case(
                "one axis lost",
                lost(&[17], |at| at.rsplitn(2, ',').last().unwrap().to_owned() + ",-9999"),
                Good(JUMP),
            ),
            gross("a far place", "900,-700,4000", JUMP),
            case(
                "a pose that repeats while the encoders move",
                |sandbox: &Sandbox| {
                    let table = sandbox.read("lab/tip.csv");
                    let held = table.lines().nth(11).unwrap().splitn(3, ',').nth(2).unwrap().to_owned();
                    let row = |(k, line): (usize, &str)| match k {
                        12..16 => line.splitn(3, ',').take(2).collect::<Vec<_>>().join(",") + "," + &held + "\n",
                        _ => format!("{line}\n"),
                    };
                    sandbox.write("lab/tip.csv", &table.lines().enumerate().map(row).collect::<String>());
                },
                Good("4 of 49 poses have no position, or repeat the last one while the encoders move"),
            ),
            case("the straight pose lost", lost(&[0], |_| "0,0,0".to_owned()), Told(&["straight = 0"])),
        ],
    );
}
