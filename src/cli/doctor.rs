//! `adagio doctor ros2 [SCENARIO]`

use super::{DoctorArgs, Ending};

/// Say what is on the network, and whether a run can begin.
#[cfg(feature = "ros2")]
pub fn doctor(args: &DoctorArgs) -> Result<(), Ending> {
    use super::{print, print_json};
    use crate::ros2::Doctor;
    use crate::scenario::{Ros2, Scenario};

    /// Without a scenario, what robots usually call their topics.
    const USUAL: &str = "[robot]\nbody = \"ros2\"\n[[world.room]]\ncorners = [[0, 0], [9, 9]]\n[[task]]\nname = \"any\"\ngoal = \"shown\"\n";

    if !(args.seconds > 0.0 && args.seconds <= 3600.0) {
        return Err(Ending::Usage(format!("--seconds {} is not allowed: it must be in (0, 3600]", args.seconds)));
    }
    let scenario = match &args.scenario {
        Some(path) => Scenario::load(path, &args.set),
        None => Scenario::parse(USUAL, "ros2.toml".as_ref(), &args.set),
    };
    let settings: Option<Ros2> = scenario.map_err(Ending::usage)?.ros2;
    let settings = settings.ok_or_else(|| Ending::Usage("the scenario's robot.body is not \"ros2\"".into()))?;
    let doctor = Doctor::listen(&settings, args.seconds).map_err(|error| Ending::Failed(error.to_string()))?;
    if let (Some(path), Some(picture)) = (&args.picture, &doctor.picture) {
        std::fs::write(path, picture)
            .map_err(|cause| Ending::Failed(format!("cannot write {}: {cause}", path.display())))?;
    }
    if args.json {
        print_json(&doctor)?
    } else {
        print(&doctor.to_string())?
    }
    match doctor.findings.iter().find(|finding| finding.is_error) {
        None => Ok(()),
        Some(finding) => Err(Ending::Failed(finding.text.clone())),
    }
}

/// Say that this program cannot.
#[cfg(not(feature = "ros2"))]
pub fn doctor(_: &DoctorArgs) -> Result<(), Ending> {
    Err(Ending::Usage("this program was built without ROS 2: build it with --features ros2".into()))
}
