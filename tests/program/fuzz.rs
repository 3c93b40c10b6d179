//! Promise: libFuzzer finds nothing in the parsers. Part of the long tests, since it takes minutes, a nightly compiler, a C++
//! compiler and `cargo install cargo-fuzz`:
//!
//! ```text
//! cargo test --release --test program fuzz -- --ignored --nocapture       # ADAGIO_FUZZ_SECONDS for each target, 60 without
//! ```

use std::process::Command;

use crate::common::{package_file, stderr};

#[test]
#[ignore = "takes minutes, needs a nightly compiler and cargo-fuzz"]
fn the_fuzz_targets_find_nothing() {
    let seconds = std::env::var("ADAGIO_FUZZ_SECONDS").unwrap_or_else(|_| "60".into());
    for target in ["log", "cdr", "checkpoint", "scenario"] {
        let folder = tempfile::tempdir().unwrap();
        // What it finds to be new goes to the first folder; what once failed is where it begins.
        let known = package_file("tests/inputs").join(target);
        let output = Command::new("cargo")
            .current_dir(package_file("fuzz"))
            .args(["+nightly", "fuzz", "run", target])
            .args([folder.path(), &known])
            .args(["--", "-rss_limit_mb=2048", "-timeout=20"])
            .arg(format!("-max_total_time={seconds}"))
            .output()
            .unwrap();
        let said = stderr(&output);
        assert!(output.status.success(), "{target}: {}\n{said}", output.status);
        let done = said.lines().rfind(|line| line.starts_with("Done ")).unwrap_or_else(|| panic!("{target}: {said}"));
        println!("{target}: {done}");
    }
}
