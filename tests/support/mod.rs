//! Where the golden vectors come from: `tests/golden`, or the folder that `GOLDEN_DIR` names.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

/// Every golden file that has a top-level array `key`, with its path. Prints file and count.
///
/// # Panics
/// If there is none, or one is empty: a golden test without vectors proves nothing.
pub fn golden_files(key: &str) -> Vec<(PathBuf, Value)> {
    let dir = std::env::var_os("GOLDEN_DIR").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden"),
        PathBuf::from,
    );
    let entries = fs::read_dir(&dir).unwrap_or_else(|e| panic!("{}: {e}", dir.display()));
    let mut paths: Vec<_> = entries
        .map(|entry| entry.expect("readable folder").path())
        .collect();
    paths.retain(|path| path.extension().is_some_and(|ext| ext == "json"));
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let value: Value =
            serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        if let Some(rows) = value.get(key).and_then(Value::as_array) {
            println!("{}: {} {key}", path.display(), rows.len());
            assert!(!rows.is_empty(), "{} has no {key}", path.display());
            found.push((path, value));
        }
    }
    assert!(
        !found.is_empty(),
        "no golden file with `{key}` in {}",
        dir.display()
    );
    found
}

/// Fails unless |actual − expected| ≤ tol · max(1, |expected|).
pub fn assert_close(what: &str, actual: f64, expected: f64, tol: f64) {
    let error = (actual - expected).abs();
    assert!(
        error <= tol * expected.abs().max(1.0),
        "{what}: {actual:e} instead of {expected:e}, off by {error:e}"
    );
}
