//! Features of a run obey their constraints on the frames they were learned from: read back from the run's own log.

use crate::common::smoke_run;
use adagio::agent::{CHECKPOINT_NAME, read_checkpoint};
use adagio::log::messages::{Decision, Image};
use adagio::log::{LogReader, Record};
use adagio::policy::columns;
use adagio::vision::Observation;
use faer::Par;

#[test]
fn features_have_mean_0_variance_1_no_correlation_and_ascending_slowness() {
    let folder = tempfile::tempdir().unwrap();
    // Small blocks and an odd number of frames between re-solves, so that growth and solving interleave.
    let settings = ["--set", "dictionary.block_frames=37", "--set", "agent.resolve_frames=777"];
    let run = smoke_run(folder.path(), "run", &settings);
    let path = run.join(CHECKPOINT_NAME);
    let (learned, scenario) = read_checkpoint(&std::fs::read(&path).unwrap(), &path).unwrap();

    let (mut observations, mut actions) = (Vec::new(), Vec::new());
    for record in LogReader::open(&run.join("run_000.mcap")).unwrap() {
        let record = record.unwrap();
        let Record::Message { topic, sequence, .. } = &record else { continue };
        match topic.as_ref() {
            "/camera/observation" => {
                let image: Image = record.decode().unwrap();
                observations.push(Observation { frame: u64::from(*sequence), pixels: image.data });
            }
            "/adagio/decision" => actions.push(record.decode::<Decision>().unwrap()),
            _ => {}
        }
    }
    observations.sort_by_key(|observation| observation.frame);
    let n = observations.len();
    assert_eq!(n as u64, learned.frames, "the last model knows all frames");

    let phi = learned.features(columns(observations.iter()).as_ref(), Par::Seq);
    let k = phi.nrows() - 1;
    assert_eq!(k, 60);
    let product = |i: usize, j: usize| (0..n).map(|t| phi[(i, t)] * phi[(j, t)]).sum::<f64>() / n as f64;
    for i in 1..=k {
        let mean = (0..n).map(|t| phi[(i, t)]).sum::<f64>() / n as f64;
        assert!(mean.abs() < 1e-7, "feature {i} has mean {mean}");
        for j in 1..=i {
            let expected = f64::from(u8::from(i == j));
            assert!((product(i, j) - expected).abs() < 1e-7, "features {i}, {j}: {}", product(i, j));
        }
    }

    // Slowness as it is defined: derivatives in seconds, weighted 5 : 1 for moving and turning.
    let frames_per_action = scenario.robot.frames_per_action;
    let dt = scenario.robot.frame_seconds();
    let weight = |t: usize| match actions[(t - 1) / frames_per_action].action {
        Decision::FORWARD => scenario.slow.move_weight,
        _ => 1.0,
    };
    let total: f64 = (1..n).map(weight).sum();
    let mut last = 0.0;
    for i in 1..=k {
        let slowness = (1..n).map(|t| weight(t) * ((phi[(i, t)] - phi[(i, t - 1)]) / dt).powi(2)).sum::<f64>() / total;
        let reported = learned.model.slowness[i - 1];
        assert!((slowness - reported).abs() < 1e-6 * slowness, "feature {i}: {slowness} against {reported}");
        assert!(reported >= last, "feature {i} is slower than the one before");
        last = reported;
    }
}
