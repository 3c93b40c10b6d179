//! When models are asked for, and from which frame on they act.

use std::collections::BTreeMap;

use crate::scenario::{Agent, Mode};

/// What happened in a recording beside its frames. Up to its last frame a repetition does the same.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordedEvents {
    /// The frame at which each model was asked for, and the first frame that it acted on, if it came to that.
    requests: BTreeMap<u64, Option<u64>>,
    last_frame: Option<u64>,
    decisions: u64,
}

impl RecordedEvents {
    /// A model was asked for at a frame.
    pub fn asked(&mut self, frame: u64) {
        self.requests.entry(frame).or_insert(None);
    }

    /// The model that was asked for at `asked_at` acted from a frame on.
    pub fn effective(&mut self, asked_at: u64, frame: u64) {
        self.requests.insert(asked_at, Some(frame));
    }

    /// A frame was seen.
    pub fn seen(&mut self, frame: u64) {
        self.last_frame = self.last_frame.max(Some(frame));
    }

    /// An action was decided on.
    pub fn decided(&mut self) {
        self.decisions += 1;
    }

    /// The last frame.
    pub fn last_frame(&self) -> Option<u64> {
        self.last_frame
    }

    /// Actions that were decided on.
    pub fn decisions(&self) -> u64 {
        self.decisions
    }
}

/// The timing of models in a run.
#[derive(Debug, Clone)]
pub enum ModelTiming {
    /// A model is asked for at every multiple of `every` frames, and acts from the frame `latency` later on.
    Lockstep {
        /// Frames between requests.
        every: u64,
        /// Frames from request to effect.
        latency: u64,
    },
    /// A model is asked for as soon as the solver is free after every multiple of `every` frames, and acts when it is ready.
    /// Where a recording is repeated, it happens at the recorded frames.
    Realtime {
        /// Frames between requests, at least.
        every: u64,
        /// Frames of recorded requests, with the frame from which each model acts.
        recorded: BTreeMap<u64, u64>,
        /// The last frame of the recording.
        to: Option<u64>,
    },
}

impl ModelTiming {
    /// The timing of a scenario, and up to its end that of a recording if there is one to repeat.
    pub fn new(settings: &Agent, recording: Option<&RecordedEvents>) -> Self {
        let (every, latency) = (settings.resolve_frames as u64, settings.latency_frames as u64);
        if settings.mode == Mode::Lockstep {
            // It is the same in every repetition.
            return ModelTiming::Lockstep { every, latency };
        }
        let mut recorded = BTreeMap::new();
        if let Some(course) = recording {
            // Answers come in the order of requests: one without a model, which never acted, is taken with the next.
            let mut next = u64::MAX;
            for (&asked, &effective) in course.requests.iter().rev() {
                next = effective.unwrap_or(next);
                recorded.insert(asked, next);
            }
        }
        ModelTiming::Realtime { every, recorded, to: recording.and_then(RecordedEvents::last_frame) }
    }

    /// Whether a model becomes due with the frame that makes it `frames` frames.
    pub fn is_due(&self, frames: u64) -> bool {
        let (ModelTiming::Lockstep { every, .. } | ModelTiming::Realtime { every, .. }) = self;
        frames > 0 && frames.is_multiple_of(*every)
    }

    /// Whether the actor that acts has to wait for a model that is asked for at this frame, which makes it `frames` frames. `changed`:
    /// there are other goals with it, and where there is a model policies are fitted to them.
    pub fn announces(&self, frame: u64, frames: u64, changed: bool) -> bool {
        match self {
            ModelTiming::Lockstep { every, .. } => self.is_due(frames) || changed && frames > *every,
            ModelTiming::Realtime { recorded, .. } => self.is_recorded(frame) && recorded.contains_key(&frame),
        }
    }

    /// Whether a model is asked for at this frame, where one is `owed` or not and the solver has room or not.
    pub fn asks(&self, frame: u64, owed: bool, has_room: bool) -> bool {
        match self {
            ModelTiming::Lockstep { .. } => owed,
            ModelTiming::Realtime { recorded, .. } if self.is_recorded(frame) => recorded.contains_key(&frame),
            // A busy solver never stops the stream.
            ModelTiming::Realtime { .. } => owed && has_room,
        }
    }

    /// The frame from which an announced model acts.
    pub fn effective(&self, asked_at: u64) -> u64 {
        match self {
            ModelTiming::Lockstep { latency, .. } => asked_at.saturating_add(*latency),
            ModelTiming::Realtime { recorded, .. } => recorded.get(&asked_at).copied().unwrap_or(u64::MAX),
        }
    }

    /// Whether models act as soon as they are ready at this frame.
    pub fn polls(&self, frame: u64) -> bool {
        matches!(self, ModelTiming::Realtime { .. }) && !self.is_recorded(frame)
    }

    fn is_recorded(&self, frame: u64) -> bool {
        matches!(self, ModelTiming::Realtime { to: Some(to), .. } if frame <= *to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn settings(mode: &str) -> Agent {
        let text = include_str!("../../../scenarios/smoke.toml");
        let sets = [
            format!("agent.mode=\"{mode}\""),
            "agent.resolve_frames=100".to_owned(),
            "agent.latency_frames=40".to_owned(),
        ];
        Scenario::parse(text, std::path::Path::new("smoke.toml"), &sets).unwrap().agent
    }

    #[test]
    fn lockstep_is_fixed_whatever_was_recorded() {
        let mut course = RecordedEvents::default();
        course.asked(7);
        course.seen(1000);
        let timing = ModelTiming::new(&settings("lockstep"), Some(&course));
        assert!(timing.is_due(200) && !timing.is_due(201) && !timing.is_due(0));
        assert!(timing.announces(199, 200, false) && !timing.announces(7, 8, false));
        assert!(
            timing.announces(207, 208, true) && !timing.announces(7, 8, true),
            "before the first model nothing is fitted"
        );
        assert!(timing.asks(199, true, false) && !timing.asks(200, false, true));
        assert_eq!(timing.effective(199), 239);
        assert!(!timing.polls(5000));
    }

    #[test]
    fn realtime_follows_the_recording_to_its_end_and_then_its_own_time() {
        let mut course = RecordedEvents::default();
        for asked in [99, 205, 301, 450] {
            course.asked(asked);
        }
        course.effective(99, 150);
        // No model came of the request at 205: its answer is taken with the next one.
        course.effective(301, 400);
        course.seen(500);
        let timing = ModelTiming::new(&settings("realtime"), Some(&course));
        assert!(timing.asks(205, false, false) && !timing.asks(206, true, true));
        assert!(timing.announces(450, 451, false) && !timing.announces(199, 200, true));
        assert_eq!([99, 205, 301, 450].map(|asked| timing.effective(asked)), [150, 400, 400, u64::MAX]);
        assert!(!timing.polls(500) && timing.polls(501));
        assert!(timing.asks(501, true, true) && !timing.asks(501, true, false) && !timing.asks(501, false, true));
    }
}
