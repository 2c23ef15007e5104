//! The folder that a run leaves holds everything that replays it.

use std::fs;
use std::path::PathBuf;

use sphere_protocol::time::Span;
use sphere_sim::metrics::{RunMetrics, RunRecord};
use sphere_sim::output::{FileError, read_scenario, write_run};
use sphere_sim::trace::Trace;

/// A folder of this test alone, empty.
fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("the test's own folder");
    folder
}

#[test]
fn a_written_run_reads_back_as_the_same_scenario_wherever_it_came_from() {
    let folder = folder("written_run");
    fs::create_dir_all(folder.join("robots")).expect("a folder");
    fs::create_dir_all(folder.join("scenarios")).expect("a folder");
    fs::write(
        folder.join("robots/mine.toml"),
        include_str!("../protocol/robots/liu.toml"),
    )
    .expect("a file");
    let file = folder.join("scenarios/demo.toml");
    fs::write(
        &file,
        "[[robots]]\nid = \"r1\"\nrobot = \"../robots/mine.toml\"\nmission = { kind = \"sine\" }\n",
    )
    .expect("a file");

    let scenario =
        read_scenario(&file, &["network.delay_ms=200".to_owned()]).expect("a valid scenario");
    let trace = Trace::new();
    let run = RunRecord {
        seed: scenario.seed,
        duration: scenario.duration(),
        wall_s: 0.1,
        settle: Span::ZERO,
        violations: Vec::new(),
    };
    let metrics = RunMetrics::new(&trace, run, &[]);
    let out = folder.join("new/out");
    let plots = [("r1-path.svg".to_owned(), "<svg/>".to_owned())];
    write_run(&out, &scenario, &metrics, &trace, &plots).expect("a writable folder");

    let mut names: Vec<_> = fs::read_dir(&out)
        .expect("it was written")
        .map(|entry| {
            entry
                .expect("readable")
                .file_name()
                .into_string()
                .expect("text")
        })
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "metrics.json",
            "r1-path.svg",
            "robot-mine.toml",
            "scenario.toml",
            "trace.csv"
        ]
    );
    let again = read_scenario(&out.join("scenario.toml"), &[]).expect("drawn");
    assert_eq!(again, scenario);
    assert_eq!(
        fs::read_to_string(out.join("metrics.json")).expect("written"),
        metrics.json()
    );
    assert!(
        fs::read_to_string(out.join("trace.csv"))
            .expect("written")
            .starts_with("t_s,robot,mode,true_x_m,")
    );
}

#[test]
fn files_that_cannot_be_read_or_written_are_named() {
    let folder = folder("unreadable");
    let missing = folder.join("missing.toml");
    let error = read_scenario(&missing, &[]).expect_err("no such file");
    assert!(matches!(error, FileError::Read { .. }));
    assert!(error.to_string().contains("missing.toml"), "{error}");

    let file = folder.join("demo.toml");
    fs::write(&file, "[[robots]]\nid = \"r1\"\nrobot = \"none.toml\"\n").expect("a file");
    let error = read_scenario(&file, &[])
        .expect_err("no such robot file")
        .to_string();
    assert!(
        error.contains("demo.toml:3: robots.0.robot = \"none.toml\": cannot read"),
        "{error}"
    );

    fs::write(&file, "[[robots]]\nid = \"r1\"\n").expect("a file");
    let scenario = read_scenario(&file, &[]).expect("valid");
    let run = RunRecord {
        seed: 1,
        duration: Span::ZERO,
        wall_s: 0.0,
        settle: Span::ZERO,
        violations: Vec::new(),
    };
    let metrics = RunMetrics::new(&Trace::new(), run, &[]);
    // A file stands where the folder should be.
    let error = write_run(&file, &scenario, &metrics, &Trace::new(), &[])
        .expect_err("no folder")
        .to_string();
    assert!(
        error.contains("demo.toml") && error.contains("--out"),
        "{error}"
    );
}
