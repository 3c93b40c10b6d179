//! The thesis's experiments on our simulator, one command each: settings → cached results → tables and plots.
//!
//! Each file is one experiment. It asks the [`Bench`] for the result of each setting, which computes it or takes it from the
//! [`Cache`], and makes tables and plots of them. The thesis's own figures stand in columns of their own; where the thesis
//! prints no number (most of its figures are curves) they stay empty.
//!
//! | experiment | thesis |
//! |---|---|
//! | [`slowness`] | figures *SvC*, *slowness* |
//! | [`responses`] | figures *sfa_compare*, *nomix*, *mix* |
//! | [`pose_lspi`] | figure *pi_overfitting* |
//! | [`vision_lspi`] | figure *pi_nf_sim* |
//! | [`two_rooms::responses`] | figure *egyptfeats* |
//! | [`two_rooms::lspi`] | figure *pi_nf_egypt* |
//! | [`trajectories`] | figure *robotest* |
//! | [`selection`] | §2.2.6; Böhmer et al. 2013 |
//! | [`online`] | none: the stream against the thesis's and other methods |
//! | [`values`] | none: local values against linear ones |
//! | [`worlds`] | none: the agent in all worlds, beside what it is to be compared with |
//! | [`place_cells`] | §4.2.3; Franzius et al. 2007 |
//! | [`online_hierarchy`] | §4.2.3, figure *Wyss06*; Wyss et al. 2006 |
//! | [`slam`] | none: the comparison with SLAM that §1 and §6 ask for |
//! | [`receptive_fields`] | §4.2.1; Berkes & Wiskott 2005 |
//! | [`digits`] | §4.2.2; Berkes 2005 |

mod alike;
mod band;
mod bench;
mod cache;
mod data;
pub mod digits;
mod driven;
mod error;
mod field;
mod lab;
mod local;
mod maps;
pub mod online;
pub mod online_hierarchy;
mod pairs;
mod pipeline;
pub mod place_cells;
mod planned;
mod plot;
pub mod pose_lspi;
mod quality;
pub mod receptive_fields;
pub mod responses;
mod seeds;
pub mod selection;
pub mod slam;
pub mod slowness;
mod spans;
mod table;
mod trained;
pub mod trajectories;
pub mod two_rooms;
pub mod values;
pub mod vision_lspi;
pub mod worlds;

pub use band::{BAND, Band};
pub use bench::{Bench, Experiment, Once, Results, Scope, Size, Sizes, keep, page, part_of, run};
pub use cache::{Cache, Cached, Found};
pub use error::ExperimentError;
pub use seeds::Seeds;
pub use table::{Cell, SAYS, Table};

/// All experiments, in the order of the thesis.
pub const ALL: &[Experiment] = &[
    slowness::EXPERIMENT,
    responses::EXPERIMENT,
    two_rooms::responses::EXPERIMENT,
    pose_lspi::EXPERIMENT,
    vision_lspi::EXPERIMENT,
    two_rooms::lspi::EXPERIMENT,
    trajectories::EXPERIMENT,
    selection::EXPERIMENT,
    online::EXPERIMENT,
    values::EXPERIMENT,
    worlds::EXPERIMENT,
    place_cells::EXPERIMENT,
    online_hierarchy::EXPERIMENT,
    slam::EXPERIMENT,
    receptive_fields::EXPERIMENT,
    digits::EXPERIMENT,
];

/// The experiment of a name.
///
/// # Errors
/// There is none; the error lists those there are.
pub fn find(name: &str) -> Result<&'static Experiment, ExperimentError> {
    ALL.iter().find(|experiment| experiment.name == name).ok_or_else(|| {
        let near = ALL.iter().map(|experiment| (strsim::jaro_winkler(experiment.name, name), experiment.name));
        let nearest = near.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(likeness, _)| *likeness > 0.8);
        ExperimentError::Unknown {
            name: name.to_owned(),
            known: ALL.iter().map(|experiment| experiment.name).collect::<Vec<_>>().join(", "),
            hint: nearest.map_or(String::new(), |(_, name)| format!("; did you mean {name}?")),
        }
    })
}
