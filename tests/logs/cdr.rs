//! Promise: a message comes back from its bytes as it was, and no bytes make decoding panic.

use crate::log_samples::decode_all;
use adagio::log::{
    Message, cdr,
    messages::{Header, Health, Image, PolicyUpdate, Transition},
};
use proptest::prelude::*;

prop_compose! {
    fn header()(stamp_ns in 0..(1u64 << 60), frame_id in "\\PC{0,9}") -> Header {
        Header::new(stamp_ns, &frame_id)
    }
}

/// Numbers that equal themselves.
fn numbers() -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(any::<f64>().prop_filter("not a number", |x| !x.is_nan()), 0..9)
}

fn texts() -> impl Strategy<Value = Vec<String>> {
    proptest::collection::vec("\\PC{0,5}", 0..4)
}

fn comes_back<M: Message + PartialEq + std::fmt::Debug>(message: M) {
    let bytes = cdr::encode(&message).unwrap();
    assert_eq!(cdr::decode::<M>(&bytes).unwrap(), message);
    for length in 0..bytes.len() {
        assert!(cdr::decode::<M>(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
    }
}

proptest! {
    #[test]
    fn an_image_comes_back(
        header in header(), size in any::<(u32, u32, u32)>(), encoding in "\\PC{0,9}",
        data in proptest::collection::vec(any::<u8>(), 0..99),
    ) {
        let (height, width, step) = size;
        comes_back(Image { header, height, width, encoding, is_bigendian: 0, step, data });
    }

    #[test]
    fn a_transition_comes_back(
        header in header(), frames in any::<(u64, u64)>(), action in any::<u8>(),
        blocked in any::<bool>(), tasks in texts(), rewards in numbers(),
    ) {
        let (from_frame, to_frame) = frames;
        comes_back(Transition { header, from_frame, to_frame, action, blocked, tasks, rewards });
    }

    #[test]
    fn a_policy_comes_back(
        header in header(), counts in any::<(u32, u32, u32, u32, u32)>(), gamma in 0.0..1.0,
        frame in any::<u64>(), converged in any::<bool>(), weights in numbers(), texts in ("\\PC{0,9}", "\\PC{0,9}"),
    ) {
        let (epoch, transitions, iterations, actions, features) = counts;
        let (task, digest) = texts;
        comes_back(PolicyUpdate {
            header, epoch, effective_at_frame: frame, task, gamma, transitions, iterations,
            converged, actions, features, weights, digest,
        });
    }

    #[test]
    fn a_health_message_comes_back(
        header in header(), frames in any::<(u64, u64, u64)>(), queues in texts(),
        depths in proptest::collection::vec(any::<u32>(), 0..5), rate in 0.0..1e9,
    ) {
        comes_back(Health {
            header, frames: frames.0, dropped_frames: frames.1, quarantined_frames: frames.2, frames_per_second: rate,
            queues, queue_capacities: depths.clone(), queue_depths: depths,
            rss_bytes: frames.2, ..Health::default()
        });
    }

    #[test]
    fn hostile_bytes_decode_to_an_error_or_a_message(
        mut bytes in proptest::collection::vec(prop_oneof![Just(0u8), Just(0xff), any::<u8>()], 0..400),
        little_endian in any::<bool>(),
    ) {
        if little_endian && bytes.len() >= 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        decode_all(&bytes);
    }
}
