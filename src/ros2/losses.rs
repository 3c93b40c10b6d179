//! What was lost on the way to the loop of control.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use crate::lock::lock;

/// Messages that came and were not taken in time, or could not be used, by topic.
#[derive(Debug, Clone, Default)]
pub struct Losses(Arc<Mutex<BTreeMap<String, u64>>>);

impl Losses {
    /// One more of a topic.
    pub fn add(&self, topic: &str) {
        *lock(&self.0).entry(topic.to_owned()).or_insert(0) += 1;
    }

    /// How many of which topics so far.
    pub fn now(&self) -> BTreeMap<String, u64> {
        lock(&self.0).clone()
    }
}
