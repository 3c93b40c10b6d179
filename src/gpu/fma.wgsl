// As many sums and products as a device can do: eight chains of four in each thread, in registers, written out by rates.rs.

@group(0) @binding(0) var<storage, read_write> results: array<vec4f>;

@compute @workgroup_size(256)
fn chains(@builtin(global_invocation_id) id: vec3u) {
    let start = vec4f(f32(id.x) * 1e-9);
    var a = start;
    var b = start + 0.1;
    var c = start + 0.2;
    var d = start + 0.3;
    var e = start + 0.4;
    var f = start + 0.5;
    var g = start + 0.6;
    var h = start + 0.7;
    let factor = vec4f(0.999);
    let more = vec4f(0.001);
    for (var i = 0u; i < STEPS; i++) {
//CHAINS//
    }
    results[id.x] = a + b + c + d + e + f + g + h;
}
