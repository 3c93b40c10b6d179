//! How the program did over time: latencies, queues, speed and memory.

use super::{Figure, Item, Material, Section};
use crate::report::draw::{Axis, Chart, DrawError, Line, SERIES};
use crate::report::gather::HealthSeen;

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let gathered = material.gathered;
    let health: Vec<&HealthSeen> = gathered.health.iter().collect();
    let mut items = Vec::new();
    if health.is_empty() {
        let reason = "There are no latencies and queues to show: the log holds no /adagio/health.".to_owned();
        return Ok(Section { name: "health", heading: "How the program did", items: vec![Item::Missing(reason)] });
    }
    // Minutes of the log's clock; a simulation is as fast as it can.
    let line = |name: &str, colour: usize, of: &dyn Fn(&HealthSeen) -> f64| {
        let points = health.iter().map(|health| (health.seconds / 60.0, of(health))).collect();
        Line::new(name, SERIES[colour % SERIES.len()], points)
    };
    let x = || Axis::new("minutes of the log's clock");
    let mut add = |name: &str, title: &str, y: Axis, lines: Vec<Line>, caption: &str| {
        let svg = Chart { height: 280, ..Chart::new(title, x(), y, lines) }.svg()?;
        items.push(Item::Figure(Figure::new(name, title, caption, svg)));
        Ok::<(), DrawError>(())
    };
    add(
        "latency",
        "Latency",
        Axis::log("99th percentile, ms"),
        vec![
            line("learning from a frame", 0, &|health| health.frame_ms),
            line("frame to action", 1, &|health| health.act_ms),
        ],
        "Over everything so far. The worst of each stretch where the run is long.",
    )?;
    let depth = |i: usize| health.iter().filter_map(|health| health.depths.get(i)).max().copied().unwrap_or(0);
    let (busy, idle): (Vec<_>, Vec<_>) = gathered.queues.iter().enumerate().partition(|(i, _)| depth(*i) > 0);
    let lines = busy
        .into_iter()
        .map(|(i, name)| line(name, i, &|health| health.depths.get(i).map_or(f64::NAN, |&depth| f64::from(depth))));
    let mut caption = "A queue that stays long waits for something too slow.".to_owned();
    if !idle.is_empty() {
        let idle: Vec<&str> = idle.into_iter().map(|(_, name)| &**name).collect();
        caption += &format!(" Nothing ever waited in: {}.", idle.join(", "));
    }
    add("queues", "Queue depths", Axis::new("entries that wait"), lines.collect(), &caption)?;
    let lines = vec![line("", 0, &|health| health.rate)];
    add("speed", "Speed", Axis::new("frames per second"), lines, "By the wall clock.")?;
    let lines = vec![line("", 0, &|health| health.rss as f64 / 1e6)];
    add("memory", "Memory", Axis::new("MB"), lines, "Memory of the process.")?;
    Ok(Section { name: "health", heading: "How the program did", items })
}
