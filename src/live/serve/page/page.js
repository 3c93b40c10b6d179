'use strict';
const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get('token');
const LINES = ['#266096', '#d67828', '#2e8b57', '#963c82', '#787878', '#aa8c14'];
const LINES_DARK = ['#7fb6e6', '#f0a35e', '#6fcf97', '#d58ac6', '#b5b5b5', '#dcc04e'];
const SEQUENTIAL = [[250, 247, 232], [207, 226, 214], [145, 192, 202], [84, 146, 187]];
const DIVERGING = [[33, 84, 156], [136, 178, 214], [246, 246, 243], [232, 158, 128], [165, 30, 44]];
const dark = matchMedia('(prefers-color-scheme: dark)');
const POLL_MS = 400;

let now = null, maps = null, curves = null, chosen = 0, moving = false, asked = null, sure = 0, ended = false;

async function call(path, body) {
  const options = { cache: 'no-store', headers: {} };
  if (token) options.headers.Authorization = `Bearer ${token}`;
  if (body !== undefined) {
    options.method = 'POST';
    options.headers['Content-Type'] = 'application/json';
    options.body = JSON.stringify(body);
  }
  const answer = await fetch(path, options);
  if (answer.status === 204) return null;
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.error ?? `the server answers ${answer.status}`);
  return told;
}

function say(text, good) {
  $('message').textContent = text;
  $('message').className = good ? 'good' : '';
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const line = (i) => (dark.matches ? LINES_DARK : LINES)[i % LINES.length];
const many = (n) => Math.round(n).toString().replace(/\B(?=(\d{3})+$)/g, '\u202f');
function short(v) {
  if (v === null || v === undefined || !Number.isFinite(v)) return '–';
  const size = Math.abs(v);
  if (size >= 1e6) return `${(v / 1e6).toFixed(1)} M`;
  if (size >= 1e4) return `${(v / 1e3).toFixed(0)} k`;
  return size >= 100 ? v.toFixed(0) : String(Number(v.toPrecision(3)));
}

/** A canvas in the pixels of the screen, empty; with its width and height. */
function paper(id, height) {
  const canvas = $(id), box = canvas.getBoundingClientRect(), scale = devicePixelRatio || 1;
  const [w, h] = [Math.max(1, box.width), Math.max(1, height ?? box.height)];
  if (height) canvas.style.height = `${height}px`;
  if (canvas.width !== Math.round(w * scale) || canvas.height !== Math.round(h * scale)) {
    canvas.width = Math.round(w * scale);
    canvas.height = Math.round(h * scale);
  }
  const pen = canvas.getContext('2d');
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = '12px system-ui, sans-serif';
  return [pen, w, h];
}

/** Lines over frames, with the ends of both axes and the name and last value of each line. */
function chart(id, lines, ends) {
  const [pen, w, h] = paper(id);
  const points = lines.flatMap((l) => l.points).filter((p) => p[1] !== null);
  pen.fillStyle = css('--soft');
  if (points.length === 0) { pen.fillText('nothing yet', 8, h / 2); return; }
  const x1 = Math.max(...points.map((p) => p[0]), 1), x0 = ends?.x0 ?? 0;
  const low = ends?.low ?? 0, high = ends?.high ?? (1.1 * Math.max(...points.map((p) => p[1])) || 1);
  const [left, right, top, bottom] = [40, w - 6, 16, h - 16];
  const x = (v) => left + (right - left) * (v - x0) / Math.max(x1 - x0, 1e-9);
  const y = (v) => bottom - (bottom - top) * (v - low) / Math.max(high - low, 1e-12);
  pen.strokeStyle = css('--line');
  pen.strokeRect(left, top, right - left, bottom - top);
  pen.textAlign = 'right';
  pen.fillText(short(high), left - 4, top + 8);
  pen.fillText(short(low), left - 4, bottom);
  pen.fillText(short(x1), right, h - 2);
  pen.textAlign = 'left';
  pen.fillText(short(x0), left, h - 2);
  let at = left;
  lines.forEach((l, i) => {
    pen.strokeStyle = pen.fillStyle = line(i);
    pen.lineWidth = 1.6;
    pen.beginPath();
    let open = false;
    for (const [u, v] of l.points) {
      if (v === null) { open = false; continue; }
      if (open) pen.lineTo(x(u), y(v)); else pen.moveTo(x(u), y(v));
      open = true;
    }
    pen.stroke();
    const last = l.points.findLast((p) => p[1] !== null);
    if (!last) return;
    pen.beginPath();
    pen.arc(x(last[0]), y(last[1]), 2.5, 0, 7);
    pen.fill();
    const text = `${l.name ? `${l.name} ` : ''}${short(last[1])}`;
    pen.fillText(text, at, 11);
    at += pen.measureText(text).width + 14;
  });
}

/** The features, each in a strip of its own. */
function strips(id, series) {
  const [pen, w, h] = paper(id);
  pen.fillStyle = css('--soft');
  if (series.length === 0) { pen.fillText('no model yet', 8, 20); return; }
  const tall = h / series.length;
  series.forEach((s, i) => {
    const values = s.points.map((p) => p[1]), most = Math.max(1e-9, ...values.map((v) => Math.abs(v ?? 0)));
    const middle = (i + 0.5) * tall;
    pen.strokeStyle = css('--line');
    pen.lineWidth = 1;
    pen.beginPath(); pen.moveTo(58, middle); pen.lineTo(w, middle); pen.stroke();
    pen.fillStyle = css('--soft');
    pen.fillText(`Δ ${short(now.features.slowness[i])}`, 2, middle + 4);
    pen.strokeStyle = line(i);
    pen.lineWidth = 1.6;
    pen.beginPath();
    values.forEach((v, j) => {
      const [px, py] = [58 + (w - 60) * j / Math.max(values.length - 1, 1), middle - 0.44 * tall * (v ?? 0) / most];
      if (j === 0) pen.moveTo(px, py); else pen.lineTo(px, py);
    });
    pen.stroke();
  });
}

function ramp(stops, share) {
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1), below = Math.min(Math.floor(place), stops.length - 2);
  const mix = stops[below].map((v, c) => Math.round(v + (stops[below + 1][c] - v) * (place - below)));
  return `rgb(${mix.join(' ')})`;
}

/** What the chosen map shows: its values with their ends and colours. */
function shown() {
  const tasks = now?.tasks.length ?? 0, isTask = chosen < tasks;
  const values = isTask ? maps?.values[chosen] : maps?.features[chosen - tasks];
  const finite = (values ?? []).filter((v) => v !== null);
  let [low, high] = finite.length ? [Math.min(...finite), Math.max(...finite)] : [0, 1];
  if (!isTask) { high = Math.max(Math.abs(low), Math.abs(high)); low = -high; }
  const colour = (v) => ramp(isTask ? SEQUENTIAL : DIVERGING, (v - low) / Math.max(high - low, 1e-12));
  return { isTask, values, headings: isTask ? maps?.headings[chosen] : null, low, high, colour };
}

/** From metres to the map's pixels and back, for the canvas as it is. */
function view(w, h) {
  const [low, high] = now.corners, margin = 8;
  const scale = Math.min((w - 2 * margin) / (high[0] - low[0]), (h - 2 * margin) / (high[1] - low[1]));
  const left = (w - scale * (high[0] - low[0])) / 2, bottom = h - (h - scale * (high[1] - low[1])) / 2;
  return {
    scale,
    to: ([x, y]) => [left + scale * (x - low[0]), bottom - scale * (y - low[1])],
    from: (px, py) => [low[0] + (px - left) / scale, low[1] + (bottom - py) / scale],
  };
}

function mapHeight() {
  const [low, high] = now.corners, wide = $('map').getBoundingClientRect().width;
  return Math.min(0.72 * innerHeight, Math.max(160, wide * (high[1] - low[1]) / (high[0] - low[0])));
}

function arrow(pen, [x, y], heading, length) {
  const [dx, dy] = [Math.cos(heading) * length / 2, -Math.sin(heading) * length / 2];
  pen.beginPath();
  pen.moveTo(x - dx, y - dy);
  pen.lineTo(x + dx, y + dy);
  const side = (turn) => [Math.cos(heading + turn) * length * 0.35, -Math.sin(heading + turn) * length * 0.35];
  for (const turn of [2.6, -2.6]) {
    const [sx, sy] = side(turn);
    pen.moveTo(x + dx, y + dy);
    pen.lineTo(x + dx + sx, y + dy + sy);
  }
  pen.stroke();
}

function drawMap() {
  if (!now.corners) { const [pen] = paper('map', 60); pen.fillText('no poses in the log yet', 8, 30); return; }
  const [pen, w, h] = paper('map', mapHeight()), { scale, to } = view(w, h), s = shown();
  if (s.values && maps) {
    const [dx, dy] = [(maps.high[0] - maps.low[0]) / maps.columns, (maps.high[1] - maps.low[1]) / maps.rows];
    const centre = (i) => [maps.low[0] + (i % maps.columns + 0.5) * dx, maps.low[1] + (Math.floor(i / maps.columns) + 0.5) * dy];
    s.values.forEach((v, i) => {
      if (v === null) return;
      const [x, y] = to(centre(i));
      pen.fillStyle = s.colour(v);
      pen.fillRect(x - scale * dx / 2 - 0.5, y - scale * dy / 2 - 0.5, scale * dx + 1, scale * dy + 1);
    });
    if (s.headings) {
      pen.strokeStyle = '#282c34';
      pen.lineWidth = 1.2;
      const every = scale * dx < 20 ? 2 : 1;
      s.headings.forEach((heading, i) => {
        const [column, row] = [i % maps.columns, Math.floor(i / maps.columns)];
        if (s.values[i] === null || column % every || row % every) return;
        arrow(pen, to(centre(i)), heading, Math.min(18, 0.75 * every * scale * dx));
      });
    }
  }
  pen.lineJoin = 'round';
  const path = (points) => { pen.beginPath(); points.forEach((p, i) => (i ? pen.lineTo(...to(p)) : pen.moveTo(...to(p)))); };
  pen.strokeStyle = '#c44e28';
  pen.globalAlpha = 0.75;
  pen.lineWidth = 1.3;
  path(now.way);
  pen.stroke();
  pen.globalAlpha = 1;
  for (const wall of now.walls) {
    path(wall.points);
    pen.strokeStyle = css('--ink'); pen.lineWidth = 7; pen.stroke();
    pen.strokeStyle = `rgb(${wall.colour.join(' ')})`; pen.lineWidth = 4.5; pen.stroke();
  }
  const ring = ([x, y], radius, dashed, width, colour = '#2e8b57') => {
    pen.setLineDash(dashed ? [5, 4] : []);
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.beginPath(); pen.arc(...to([x, y]), Math.max(2, scale * radius), 0, 7); pen.stroke();
    pen.setLineDash([]);
  };
  now.tasks.forEach((task, i) => {
    if (!task.goal) return;
    ring(task.goal, task.radius, false, i === chosen ? 3.5 : 1.5);
    pen.fillStyle = '#2e8b57';
    pen.textAlign = 'center';
    const [x, y] = to(task.goal);
    pen.fillText(task.name, x, y + 4);
    pen.textAlign = 'left';
  });
  for (const avoid of now.avoids) {
    if (!avoid.at) continue;
    ring(avoid.at, avoid.radius, false, 1.5, '#b3261e');
    pen.textAlign = 'center';
    pen.fillStyle = '#b3261e';
    const [x, y] = to(avoid.at);
    pen.fillText(avoid.name, x, y + 4);
    pen.textAlign = 'left';
  }
  for (const move of now.moves) ring([move.x, move.y], now.tasks[move.task].radius, true, 2);
  if (asked) ring([asked.x, asked.y], now.tasks[asked.task].radius, true, 2);
  if (now.pose) {
    const [x, y] = to(now.pose), a = now.pose[2];
    pen.beginPath();
    for (const [turn, far] of [[0, 13], [2.5, 10], [Math.PI, 4], [-2.5, 10]]) {
      pen.lineTo(x + far * Math.cos(a + turn), y - far * Math.sin(a + turn));
    }
    pen.closePath();
    pen.fillStyle = '#c44e28'; pen.strokeStyle = '#fff'; pen.lineWidth = 1.5;
    pen.fill(); pen.stroke();
  }
  const [bar, bw, bh] = paper('ramp');
  for (let i = 0; i < bw; i += 1) {
    bar.fillStyle = s.colour(s.low + (s.high - s.low) * i / bw);
    bar.fillRect(i, 0, 1.5, bh);
  }
  $('low').textContent = s.values ? short(s.low) : '';
  $('high').textContent = s.values ? short(s.high) : '';
  let text = now.missing ?? 'There is no policy yet.';
  if (s.values && s.isTask) text = `Policy ${maps.epoch}. Colours: what a place is worth, mean of headings. Arrows: where it turns to.`;
  else if (s.values) text = `Model ${maps.epoch}, mean of headings.`;
  $('map-text').textContent = text;
}

function mapButtons() {
  const names = [...now.tasks.map((t) => t.name), ...(maps?.features ?? []).map((_, i) => `feature ${i + 1}`)];
  const known = [...$('maps').children].map((b) => b.textContent).join('\n');
  if (known !== names.join('\n')) {
    $('maps').replaceChildren(...names.map((name, i) => {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = name;
      button.onclick = () => { chosen = i; draw(); };
      return button;
    }));
  }
  [...$('maps').children].forEach((button, i) => button.setAttribute('aria-pressed', String(i === chosen)));
}

function placeRows() {
  $('shown').hidden = !now.shown.length;
  const names = now.shown.map((place) => place.name).join('\n');
  if ($('places').dataset.names !== names) {
    $('places').dataset.names = names;
    $('places').replaceChildren(...now.shown.map((place) => {
      const row = document.createElement('div');
      row.className = 'buttons';
      const button = (text, hint) => {
        const made = document.createElement('button');
        [made.type, made.textContent, made.title] = ['button', text, hint];
        row.append(made);
        return made;
      };
      const mark = (how) => press('/mark', { task: place.name, how });
      const hold = button(place.avoid ? `Never go here: ${place.name}` : `This is ${place.name}`, 'Marks what the robot sees for as long as it is held');
      let renew = 0;
      const release = () => { if (renew) { clearInterval(renew); renew = 0; mark('release'); } };
      hold.onpointerdown = (event) => {
        hold.setPointerCapture(event.pointerId);
        mark('hold');
        renew ||= setInterval(() => mark('hold'), 500);
      };
      for (const end of ['onpointerup', 'onpointercancel', 'onlostpointercapture', 'onblur']) hold[end] = release;
      // A keyboard holds a key down.
      hold.onkeydown = (event) => { if ([' ', 'Enter'].includes(event.key) && !renew) { mark('hold'); renew = setInterval(() => mark('hold'), 500); } };
      hold.onkeyup = release;
      button('Turn round once', 'The robot turns once on the spot, and all that it sees is marked').onclick = () => mark('turn');
      button('Forget', 'What was marked so far does not count any more').onclick = () => mark('forget');
      row.append(document.createElement('span'));
      return row;
    }));
  }
  [...$('places').children].forEach((row, i) => {
    const place = now.shown[i];
    for (const button of row.querySelectorAll('button')) button.disabled = ended;
    row.querySelector('button').setAttribute('aria-pressed', String(now.marking === place.name));
    const count = place.marks ? `${many(place.marks)} frames marked` : 'not shown yet';
    row.lastChild.textContent = now.marking === place.name ? `${count}, marking` : count;
  });
}

function drawHealth() {
  const h = now.health, rows = [];
  if (now.dictionary) {
    const d = now.dictionary;
    $('growth-text').textContent = `Support vectors: ${many(d.size)}${d.budget ? ` of ${many(d.budget)}` : ''}${d.full ? ', full' : ''}`;
  }
  if (h) {
    rows.push(['frames per second', short(h.frames_per_second)], ['frame to action, p99', `${short(h.act_p99_ms)} ms`],
      ['learning from a frame, p99', `${short(h.frame_p99_ms)} ms`], ['memory', `${short(h.memory_mb)} MB`],
      ['queues', h.queues.map(([name, depth]) => `${name} ${depth}`).join(', ')],
      ['dropped', many(h.dropped)], ['left out of learning', many(h.quarantined)],
      ['damaged records', many(h.damaged)], ['warnings', many(h.warnings)]);
  }
  $('health').replaceChildren(...rows.flatMap(([name, value]) => {
    const [dt, dd] = [document.createElement('dt'), document.createElement('dd')];
    dt.textContent = name;
    dd.textContent = value;
    return [dt, dd];
  }));
  $('said').replaceChildren(...(h?.said ?? []).map((text) => {
    const item = document.createElement('li');
    item.textContent = text;
    return item;
  }));
}

function draw() {
  if (!now) return;
  document.title = `${now.phase}: ${now.title}`;
  $('title').textContent = now.title;
  const phase = now.pausing && now.phase === 'running' ? 'pausing' : now.phase;
  $('phase').textContent = phase;
  $('phase').className = `phase ${phase === 'pausing' ? 'paused' : phase}`;
  const of = now.planned ? ` of ${many(now.planned)}` : '';
  $('where').textContent = `frame ${many(now.frame)}, action ${many(now.actions)}${of}, ${many(now.seconds)} s of driving, model ${now.epoch}`;
  $('pause').textContent = now.pausing ? 'Go on' : 'Pause';
  for (const id of ['pause', 'stop']) $(id).disabled = ended;
  $('robot').hidden = !now.robot;
  $('robot').textContent = now.robot ? `The robot: ${now.robot}` : '';
  $('robot').className = /^(stopped|held)/.test(now.robot ?? '') ? 'stopped' : '';
  $('release').hidden = ended || !/^held/.test(now.robot ?? '');
  const place = now.tasks[chosen];
  $('goto').disabled = ended || !place;
  $('goto').textContent = place ? `Go to ${place.name}` : 'Go there';
  $('move').disabled = ended || !now.tasks[chosen]?.movable;
  $('move').setAttribute('aria-pressed', String(moving));
  $('move').textContent = chosen < now.tasks.length ? `Move the goal of ${now.tasks[chosen].name}` : 'Move the goal';
  $('map').classList.toggle('moving', moving);
  const d = now.decision;
  const values = d?.q_values.length ? ` (worth of forward ${short(d.q_values[0])}, left ${short(d.q_values[1])}, right ${short(d.q_values[2])})` : '';
  $('decision').textContent = d ? `${d.task ? `On the way to ${d.task}` : 'Exploring'}: ${d.action}${d.reflex ? ', by reflex' : ''}${values}${d.prospect == null ? '' : `. About ${Math.round(d.prospect[0])} actions to go, there in time with ${Math.round(100 * d.prospect[1])} %`}${d.sure == null ? '' : `. Sure of its place by ${Math.round(100 * d.sure)} %`}${now.pursuit ? `. Last pursuit: ${now.pursuit}` : ''}` : '';
  placeRows();
  for (const id of ['camera', 'observation']) if (now[id]) $(id).src = now[id];
  mapButtons();
  drawMap();
  strips('features', now.features.series);
  $('features-text').textContent = `Model ${now.features.epoch}: at the ends of the last actions, Δ in 1/s²`;
  drawHealth();
  if (!curves) return;
  chart('success', curves.success, { low: 0, high: 1 });
  chart('quality', curves.quality, { low: 0, high: 1 });
  chart('slowness', [{ ...curves.slowness, name: '' }]);
  chart('growth', [{ ...curves.growth, name: '' }]);
  for (const id of ['speed', 'latency', 'memory']) chart(id, [{ ...curves[id], name: '' }]);
}

async function press(path, body) {
  try {
    await call(path, body ?? {});
    say('');
    return true;
  } catch (error) {
    say(error.message);
    return false;
  }
}

$('pause').onclick = () => press(now.pausing ? '/resume' : '/pause');
$('release').onclick = () => press('/release');
$('goto').onclick = async () => {
  const { name } = now.tasks[chosen];
  if (await press('/goto', { task: name })) say(`The robot goes to ${name}, and the run is paused when it is there.`, true);
};
$('stop').onclick = async () => {
  clearTimeout(sure);
  if (!$('stop').classList.contains('sure')) {
    $('stop').classList.add('sure');
    $('stop').textContent = 'Really stop the run?';
    sure = setTimeout(calm, 4000);
    return;
  }
  calm();
  if (await press('/stop')) say('The run finishes: its log is closed, and its report written.', true);
};
function calm() {
  $('stop').classList.remove('sure');
  $('stop').textContent = 'Stop';
}
$('move').onclick = () => {
  moving = !moving;
  if (moving) say('Tap the place on the map where the goal shall be.', true); else say('');
  draw();
};
$('map').onclick = async (event) => {
  if (!moving || !now?.corners) return;
  const box = $('map').getBoundingClientRect();
  const [x, y] = view(box.width, box.height).from(event.clientX - box.left, event.clientY - box.top);
  const task = chosen;
  moving = false;
  say('');
  if (await press('/goal', { task: now.tasks[task].name, x, y })) {
    asked = { task, x, y };
    say(`The goal of ${now.tasks[task].name} shall be at (${x.toFixed(2)}, ${y.toFixed(2)}) m.`, true);
  }
  draw();
};

async function look() {
  try {
    const news = await call(`/now?since=${now?.version ?? -1}`);
    if (news) {
      now = news;
      const moved = asked && now.tasks[asked.task];
      if (moved?.goal && Math.hypot(moved.goal[0] - asked.x, moved.goal[1] - asked.y) < 1e-3) asked = null;
      if (now.maps && now.maps !== maps?.epoch) maps = await call('/maps');
      curves = await call('/curves');
      ended = now.phase === 'over';
      draw();
      if (ended) { say('The run is over; this page stays as it is.', true); return; }
    }
  } catch {
    ended = true;
    $('phase').textContent = 'no connection';
    $('phase').className = 'phase lost';
    for (const id of ['pause', 'stop', 'move', 'goto']) $(id).disabled = true;
    $('release').hidden = true;
    say('The run has ended, or cannot be reached. Trying again.');
    setTimeout(look, 3000);
    return;
  }
  setTimeout(look, POLL_MS);
}
addEventListener('resize', draw);
dark.addEventListener('change', draw);
look();
