//! What was saved and restored goes on as if nothing had happened, bit for bit.

use crate::common::{generator, random_path};
use adagio::slow::coherence::incremental::{IncrementalSlow, Options};
use adagio::slow::{LinearStream, Link};
use adagio::snapshot::{Persist, Snapshot, SnapshotError};
use adagio::value::{LocalBatch, LocalOptions};
use faer::Mat;

/// What is made of `from` in `into`.
fn restore(from: &mut impl Persist, into: &mut impl Persist) -> Result<(), SnapshotError> {
    let mut saved = Snapshot::new();
    saved.inner("it", from).unwrap();
    Snapshot::restoring(saved.matrices, saved.texts).inner("it", into)
}

#[test]
fn a_linear_stream_goes_on_alike() {
    let x = random_path(3, 700, 1);
    let links = Link::regular(700, 0.5).unwrap();
    let (mut stream, mut restored) = (LinearStream::new(), LinearStream::new());
    stream.push(x.as_ref().subcols(0, 300), &links[..300]).unwrap();
    restore(&mut stream, &mut restored).unwrap();
    for stream in [&mut stream, &mut restored] {
        stream.push(x.as_ref().subcols(300, 400), &links[300..]).unwrap();
    }
    assert_eq!(stream.solve(3, 0.0).unwrap(), restored.solve(3, 0.0).unwrap());
    let mut empty = LinearStream::new();
    restore(&mut LinearStream::new(), &mut empty).unwrap();
    assert_eq!(empty.inputs(), None);
}

#[test]
fn incremental_features_go_on_alike() {
    let x = random_path(3, 500, 2);
    let link = Some(Link { dt: 1.0, weight: 1.0 });
    let fresh = |inputs| IncrementalSlow::new(inputs, Options::new(2, inputs), &mut generator(7)).unwrap();
    let (mut stream, mut restored) = (fresh(3), fresh(3));
    let take = |stream: &mut IncrementalSlow, from, to| {
        (from..to).for_each(|t| stream.update(x.col_as_slice(t), link).unwrap());
    };
    take(&mut stream, 0, 250);
    restore(&mut stream, &mut restored).unwrap();
    take(&mut stream, 250, 500);
    take(&mut restored, 250, 500);
    assert_eq!((stream.map(), stream.slowness()), (restored.map(), restored.slowness()));
    assert!(restore(&mut stream, &mut fresh(2)).is_err());
}

#[test]
fn local_values_are_the_same() {
    let mut batch = LocalBatch::new(2, 3).unwrap();
    let points = random_path(2, 201, 3);
    for t in 0..200 {
        // Action 2 is never tried.
        let next = (t % 50 != 49).then(|| points.col_as_slice(t + 1));
        batch.push(points.col_as_slice(t), t % 2, f64::from(u8::from(next.is_none())), next).unwrap();
    }
    let mut values = batch.fit(&LocalOptions::default(), 0.9).unwrap();
    let mut single = LocalBatch::new(1, 1).unwrap();
    single.push(&[0.0], 0, 0.0, None).unwrap();
    let mut restored = single.fit(&LocalOptions::default(), 0.0).unwrap();
    restore(&mut values, &mut restored).unwrap();
    assert_eq!(values, restored);
    let at = Mat::from_fn(2, 10, |i, t| 0.1 * (i + t) as f64);
    assert_eq!(values.action_values(at.as_ref()).unwrap(), restored.action_values(at.as_ref()).unwrap());
}
