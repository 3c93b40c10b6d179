#![no_main]

#[allow(dead_code)] // one of several
#[path = "../../tests/mutations/targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    targets::log(bytes);
    targets::recover(bytes);
});
