//! Writing observations into a log, as a file in the folder for temporary files. Its kind is printed: in a `tmpfs` the file
//! stays in memory, and elsewhere nothing waits for the disk either, since the log is not synchronised with it. `TMPDIR`
//! names another folder.

mod common;

use std::collections::BTreeMap;

use common::data::frames;

use adagio::log::messages::{Header, Image};
use adagio::log::{Compression, LogOptions, LogWriter, topics};
use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};

fn main() {
    if common::wants_figures() {
        println!("logs are written to {}, file system: {}", std::env::temp_dir().display(), file_system());
    }
    common::main();
}

/// The kind of file system that temporary files lie in: that of the longest mount point above them.
fn file_system() -> String {
    let mounts = std::fs::read_to_string("/proc/self/mounts").unwrap_or_default();
    let folder = std::env::temp_dir();
    let fields = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
    let above = fields.filter(|fields| fields.len() > 2 && folder.starts_with(fields[1]));
    above.max_by_key(|fields| fields[1].len()).map_or("unknown".into(), |fields| fields[2].into())
}

/// Messages of one measurement: enough to fill several chunks.
const MESSAGES: usize = 2000;

/// Compression against the size of an image; each frame differs from the others, with 1 % noise.
#[divan::bench(args = [("zstd", 512), ("lz4", 512), ("none", 512), ("zstd", 2048)], sample_size = 1, sample_count = 10, max_time = 5)]
fn observations(bencher: Bencher, (compression, pixels): (&str, usize)) {
    let x = frames(3 * pixels, MESSAGES);
    let images: Vec<Image> = (0..MESSAGES)
        .map(|t| Image {
            header: Header::new(0, "camera"),
            height: 1,
            width: pixels as u32,
            encoding: "rgb8".into(),
            step: 3 * pixels as u32,
            data: (0..3 * pixels).map(|i| (x[(i, t)] + 128.0) as u8).collect(),
            ..Image::default()
        })
        .collect();
    let compression = match compression {
        "zstd" => Compression::Zstd,
        "lz4" => Compression::Lz4,
        _ => Compression::None,
    };
    let options = LogOptions { compression, ..LogOptions::default() };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut number = 0;
    bencher.counter(ItemsCount::new(MESSAGES)).counter(BytesCount::new(3 * pixels * MESSAGES)).bench_local(|| {
        number += 1;
        let path = folder.path().join(format!("{number}.mcap"));
        let mut log = LogWriter::create(&path, &options, &BTreeMap::new()).expect("a log in a new folder");
        for (t, image) in images.iter().enumerate() {
            log.write(topics::OBSERVATION, t as u32, t as u64, image).expect("room for a log");
        }
        log.finish().expect("room for a log")
    });
}
