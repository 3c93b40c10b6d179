//! `--ros-args`, as programs of ROS 2 take them from launch files: names that are mapped to others, and parameters.

use super::Ending;
use crate::scenario::Scenario;

/// Changes of the scenario that these arguments ask for: `-r FROM:=TO`, also of `__ns` and `__node`, and `-p KEY:=VALUE`.
pub fn sets(arguments: &[String], scenario: &Scenario) -> Result<Vec<String>, Ending> {
    let mut sets = Vec::new();
    let mut arguments = arguments.iter().map(String::as_str).filter(|argument| *argument != "--ros-args");
    while let Some(flag) = arguments.next() {
        let pair = arguments.next().and_then(|pair| pair.split_once(":="));
        let is_name = matches!(flag, "-r" | "--remap");
        let (true, Some((from, to))) = (is_name || matches!(flag, "-p" | "--param"), pair) else {
            return Err(Ending::Usage(format!("--ros-args {flag}: it must be -r FROM:=TO or -p KEY:=VALUE")));
        };
        sets.push(match (is_name, from) {
            (true, "__ns") => format!("ros2.namespace={to}"),
            (true, "__node" | "__name") => format!("ros2.node={to}"),
            (true, _) => format!("ros2.{}={to}", key_of(from, scenario)?),
            (false, "use_sim_time") => format!("ros2.use_sim_time={to}"),
            (false, _) => format!("{from}={to}"),
        });
    }
    Ok(sets)
}

/// The key of the topic of a name.
fn key_of(name: &str, scenario: &Scenario) -> Result<&'static str, Ending> {
    let Some(ros2) = &scenario.ros2 else {
        return Err(Ending::Usage("--ros-args are for a scenario with robot.body = \"ros2\"".into()));
    };
    let wanted = ros2.topic(name);
    let mut topics = ros2.topics().into_iter();
    topics.find(|(_, topic)| !topic.is_empty() && ros2.topic(topic) == wanted).map(|(key, _)| key).ok_or_else(|| {
        let names: Vec<&str> = ros2.topics().into_iter().map(|(_, topic)| topic).filter(|of| !of.is_empty()).collect();
        Ending::Usage(format!("--ros-args -r {name}:=…: the scenario's topics are {}", names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_parameters_become_keys() {
        let text = "[robot]\nbody = \"ros2\"\n[[world.room]]\ncorners = [[0, 0], [9, 9]]\n[[task]]\nname = \"any\"\ngoal = \"shown\"\n";
        let scenario = Scenario::parse(text, "ros2.toml".as_ref(), &[]).unwrap();
        let of = |text: &str| {
            let words: Vec<String> = text.split(' ').map(str::to_owned).collect();
            sets(&words, &scenario).map_err(|error| format!("{error:?}"))
        };
        let many = of(
            "-r cmd_vel:=/wheels --remap /odom:=odometry -r __ns:=/robot1 -p use_sim_time:=true --ros-args -p seed:=3",
        );
        let expected = [
            "ros2.command=/wheels",
            "ros2.odometry=odometry",
            "ros2.namespace=/robot1",
            "ros2.use_sim_time=true",
            "seed=3",
        ];
        assert_eq!(many.unwrap(), expected);
        assert!(of("-r nothing:=/x").unwrap_err().contains("camera/image_raw"));
        assert!(of("-r cmd_vel").is_err() && of("--log-level debug").is_err());
    }
}
