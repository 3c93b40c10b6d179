//! What was lost on the way to the loop of control.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Messages that came and were not taken in time, or could not be used, by topic.
#[derive(Debug, Clone, Default)]
pub struct Losses(Arc<Mutex<BTreeMap<String, u64>>>);

impl Losses {
    /// One more of a topic.
    pub fn add(&self, topic: &str) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner).entry(topic.to_owned()).or_insert(0) += 1;
    }

    /// How many of which topics so far.
    pub fn now(&self) -> BTreeMap<String, u64> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
