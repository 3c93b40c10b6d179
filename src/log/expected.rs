//! What a run that is repeated must log again, message by message.
//!
//! A replay is compared with its recording while it runs; a resumed run is compared too, and what the log holds already is
//! not written twice. Bodies are compared by a hash of 64 bits, so that hours of messages fit into memory.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher};

use super::topics;

/// Topics whose messages follow from scenario, seed and frames alone, in the order in which a difference shows on them.
const REPEATABLE: [&str; 12] = [
    topics::OBSERVATION.name(),
    topics::FRAME.name(),
    topics::TRANSITION.name(),
    topics::END.name(),
    topics::DICTIONARY.name(),
    topics::REQUEST.name(),
    topics::MODEL.name(),
    topics::POLICY.name(),
    topics::PROSPECT.name(),
    topics::PLACES.name(),
    topics::DECISION.name(),
    topics::COMMAND.name(),
];

/// Those that a decision gives: they have the stamp of what was decided on.
const DECIDED: [&str; 4] =
    [topics::PROSPECT.name(), topics::PLACES.name(), topics::DECISION.name(), topics::COMMAND.name()];

/// One message of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    stamp_ns: u64,
    hash: u64,
}

/// What a recording holds on one topic.
#[derive(Debug, Clone, Default)]
struct Topic {
    /// All messages, if the topic is repeatable.
    messages: Vec<Seen>,
    /// The stamp of the last one, and how many have that.
    last_stamp_ns: u64,
    with_last: usize,
    /// Messages that have come since.
    repeated: usize,
    repeated_with_last: usize,
}

/// The first message on a topic that was not repeated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The topic.
    pub topic: &'static str,
    /// Number of the message on its topic, from 0.
    pub index: usize,
    /// Time of the message, nanoseconds.
    pub stamp_ns: u64,
    /// What came in its place, encoded; nothing if fewer messages came than were recorded.
    pub found: Option<Vec<u8>>,
}

/// What became of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Match {
    /// The recording has it.
    Recorded,
    /// The recording does not go that far.
    New,
    /// The recording has another one in its place.
    Differs,
}

/// The messages of a recording, and how far they were repeated.
#[derive(Debug, Clone, Default)]
pub struct Expected {
    topics: BTreeMap<&'static str, Topic>,
    differences: BTreeMap<&'static str, Difference>,
}

impl Expected {
    /// Take note of a message of the recording, in its order. Topics that are not this program's are left out.
    pub fn record(&mut self, topic: &str, stamp_ns: u64, body: &[u8]) {
        let Some(name) = topics::ALL.iter().map(|known| known.name).find(|&name| name == topic) else { return };
        let entry = self.topics.entry(name).or_default();
        if stamp_ns != entry.last_stamp_ns {
            entry.with_last = 0;
        }
        (entry.last_stamp_ns, entry.with_last) = (stamp_ns, entry.with_last + 1);
        if REPEATABLE.contains(&name) {
            entry.messages.push(Seen { stamp_ns, hash: hash(body) });
        }
    }

    /// Compare the next message on a topic with the recording. On a topic that is not repeatable, such as the program's
    /// health, a message is known if the recording goes beyond its stamp.
    pub fn meet(&mut self, topic: &'static str, stamp_ns: u64, body: &[u8]) -> Match {
        let Some(entry) = self.topics.get_mut(topic) else { return Match::New };
        if !REPEATABLE.contains(&topic) {
            if stamp_ns == entry.last_stamp_ns {
                entry.repeated_with_last += 1;
            }
            let known = stamp_ns < entry.last_stamp_ns
                || stamp_ns == entry.last_stamp_ns && entry.repeated_with_last <= entry.with_last;
            return if known { Match::Recorded } else { Match::New };
        }
        let index = entry.repeated;
        entry.repeated += 1;
        match entry.messages.get(index) {
            None => Match::New,
            Some(seen) if *seen == (Seen { stamp_ns, hash: hash(body) }) => Match::Recorded,
            Some(_) => {
                let found = Some(body.to_vec());
                self.differences.entry(topic).or_insert(Difference { topic, index, stamp_ns, found });
                Match::Differs
            }
        }
    }

    /// Begin in the middle: everything up to a time counts as repeated, with what was decided at that time left to come.
    pub fn skip_to(&mut self, stamp_ns: u64) {
        for (&name, topic) in &mut self.topics {
            let decided = DECIDED.contains(&name);
            let before = |seen: &Seen| seen.stamp_ns < stamp_ns || !decided && seen.stamp_ns == stamp_ns;
            topic.repeated = topic.messages.partition_point(before);
        }
    }

    /// Take nothing that comes from a robot for something that the recording has: a real one drives on beside its recording.
    pub fn forget_robot(&mut self) {
        self.topics.retain(|name, _| !topics::is_of_robot(name));
    }

    /// Messages of repeatable topics in the recording.
    pub fn recorded(&self) -> u64 {
        self.topics.values().map(|topic| topic.messages.len() as u64).sum()
    }

    /// Messages of repeatable topics that came beyond the recording.
    pub fn beyond(&self) -> u64 {
        self.topics.values().map(|topic| topic.repeated.saturating_sub(topic.messages.len()) as u64).sum()
    }

    /// Where the repetition left the recording first: the difference with the earliest stamp, messages that did not come
    /// among them. `None` if all was repeated.
    pub fn first_difference(&self) -> Option<Difference> {
        let missing =
            self.topics.iter().filter(|(_, topic)| topic.repeated < topic.messages.len()).map(|(name, topic)| {
                let stamp_ns = topic.messages[topic.repeated].stamp_ns;
                Difference { topic: name, index: topic.repeated, stamp_ns, found: None }
            });
        let place = |difference: &Difference| {
            let place = REPEATABLE.iter().position(|&name| name == difference.topic);
            (difference.stamp_ns, place, difference.index)
        };
        self.differences.values().cloned().chain(missing).min_by_key(place)
    }
}

fn hash(body: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    hasher.write(body);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: &str = topics::MODEL.name();
    const DECISION: &str = topics::DECISION.name();
    const HEALTH: &str = topics::HEALTH.name();

    fn recording() -> Expected {
        let mut expected = Expected::default();
        for (topic, stamp, body) in
            [(DECISION, 1, b"a"), (DECISION, 2, b"b"), (MODEL, 3, b"m"), (HEALTH, 3, b"h"), (HEALTH, 3, b"i")]
        {
            expected.record(topic, stamp, body);
        }
        expected
    }

    #[test]
    fn what_is_repeated_is_known_and_the_rest_is_new() {
        let mut expected = recording();
        assert_eq!(expected.meet(DECISION, 1, b"a"), Match::Recorded);
        assert_eq!(expected.meet(DECISION, 2, b"b"), Match::Recorded);
        assert_eq!(expected.meet(DECISION, 4, b"c"), Match::New);
        assert_eq!(expected.meet(MODEL, 3, b"m"), Match::Recorded);
        // The program's health is never the same twice.
        assert_eq!(expected.meet(HEALTH, 2, b"x"), Match::Recorded);
        assert_eq!(expected.meet(HEALTH, 3, b"x"), Match::Recorded);
        assert_eq!(expected.meet(HEALTH, 3, b"x"), Match::Recorded);
        assert_eq!(expected.meet(HEALTH, 3, b"x"), Match::New);
        assert_eq!((expected.first_difference(), expected.recorded(), expected.beyond()), (None, 3, 1));
    }

    #[test]
    fn the_earliest_difference_is_named() {
        let mut expected = recording();
        assert_eq!(expected.meet(MODEL, 3, b"n"), Match::Differs);
        assert_eq!(expected.meet(DECISION, 1, b"a"), Match::Recorded);
        // The second decision does not come, and would have come before the model.
        let first = expected.first_difference().unwrap();
        assert_eq!((first.topic, first.index, first.stamp_ns, first.found), (DECISION, 1, 2, None));
        assert_eq!(expected.meet(DECISION, 2, b"b"), Match::Recorded);
        assert_eq!(expected.first_difference().unwrap().found.as_deref(), Some(&b"n"[..]));
        // Another stamp is a difference too.
        let mut expected = recording();
        assert_eq!(expected.meet(DECISION, 9, b"a"), Match::Differs);
    }

    #[test]
    fn a_run_that_goes_on_decides_again_at_the_moment_that_it_goes_on_from() {
        let mut expected = recording();
        for topic in DECIDED.into_iter().chain([topics::FRAME.name()]) {
            [2, 3].iter().for_each(|&stamp| expected.record(topic, stamp, b"b"));
        }
        expected.skip_to(2);
        for topic in DECIDED {
            assert_eq!(expected.meet(topic, 2, b"b"), Match::Recorded, "{topic}");
        }
        assert_eq!(expected.meet(topics::FRAME.name(), 3, b"b"), Match::Recorded);
    }

    #[test]
    fn a_robot_whose_clock_was_set_back_says_nothing_twice() {
        let odometry = topics::ROBOT_ODOMETRY.name();
        let mut expected = recording();
        expected.record(odometry, 100, b"o");
        assert_eq!(expected.meet(odometry, 50, b"p"), Match::Recorded);
        expected.forget_robot();
        assert_eq!(expected.meet(odometry, 50, b"p"), Match::New);
        assert_eq!(expected.meet(HEALTH, 2, b"x"), Match::Recorded);
    }
}
