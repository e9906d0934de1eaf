// The operator's page: live picture, state ten times a second, a click sets the goal, Stop is always there.

import { draw, pixelAt } from "./overlay.js";

const QUIET_MS = 1500; // no word from the server for this long: what is shown is old
const CLICK_PX = 8; // a pointer that moves farther drags, and sets no goal
const STATUS = { no_goal: "No goal", driving: "Driving", arrived: "Arrived", stopped: "Stopped", waiting: "Waiting" };
const CAMERA = { init: "no picture", stale: "picture stale", reconnecting: "camera lost", ended: "camera ended" };
const STOP_AGAIN_MS = 500;
const HINT = "Click or tap in the picture to send the robot there.";

const $ = (id) => document.getElementById(id);
const canvas = $("overlay");
let state = null;
let heardAt = 0;
let pressed = null;
let wasQuiet = false;
const unheardStops = new Set(); // robots whose Stop has not got through to the server

// The token came with the page and is a cookie now: it need not stay in the address bar.
if (location.search) history.replaceState(null, "", location.pathname);

function chosen() {
  return $("robot").value;
}

/** Whether the server has been silent for so long that what is shown is old. */
function isQuiet() {
  return performance.now() - heardAt > QUIET_MS;
}

function listen() {
  const address = new URL("api/v1/events", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(address);
  socket.onmessage = (event) => show(JSON.parse(event.data));
  socket.onclose = () => setTimeout(listen, 1000);
}

async function pollWhileQuiet() {
  if (isQuiet()) {
    const answer = await call("GET", "state").catch(() => null);
    if (answer) show(answer);
  }
  setTimeout(pollWhileQuiet, 700);
}

function show(next) {
  state = next;
  heardAt = performance.now();
  const names = state.robots.map((robot) => robot.name);
  const select = $("robot");
  if (names.join() !== [...select.options].map((option) => option.value).join()) {
    const keep = select.value;
    select.replaceChildren(...names.map((name) => new Option(name, name)));
    if (names.includes(keep)) select.value = keep;
  }
  render();
}

function render() {
  const quiet = isQuiet();
  document.body.classList.toggle("stale", quiet);
  if (!state) {
    badge("no answer from the server", "bad");
    return;
  }
  const running = state.camera.state === "running" && !quiet;
  const size = state.camera.size_px;
  if (size) $("view").style.aspectRatio = `${size[0]} / ${size[1]}`;
  $("view").classList.toggle("stale", !running);
  if (quiet) badge("server silent", "bad");
  else if (running) badge("live", "good");
  else badge(CAMERA[state.camera.state], "bad");
  const trouble = quiet ? "The server is silent: nothing here is current" : `Camera: ${state.camera.reason}`;
  setText("notice", running ? "" : trouble);
  $("notice").hidden = running;
  draw(canvas, state, { chosen: chosen(), quiet });
  renderRobot(state.robots.find((robot) => robot.name === chosen()), quiet);
}

function badge(text, kind) {
  setText("badge", text);
  $("badge").className = `badge ${kind}`;
}

function setText(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text; // screen readers repeat what is set again
}

function renderRobot(robot, quiet) {
  if (!robot) return;
  setText("status", quiet ? "No contact" : STATUS[robot.status]);
  $("status").className = `status ${quiet ? "unknown" : robot.status}`;
  setText("reason", quiet ? "A robot that gets no plans stands by itself." : robot.reason ?? advice(robot));
  $("resume").hidden = robot.status !== "stopped";
  $("drop").hidden = robot.goal === null;
  const { fps, frame_age_s: age } = state.camera;
  const tick = state.timings_ms.tick;
  const calibration = state.camera.calibration;
  $("map-box").hidden = !calibration;
  const facts = {
    ...(calibration && { "Calibration": calibrated(calibration) }),
    "Picture": age === null ? "none yet" : `${age.toFixed(1)} s old${fps ? `, ${fps.toFixed(0)} fps` : ""}`,
    "Robot seen": ago(robot.sighting_age_s),
    "Robot heard": ago(robot.robot_state_age_s),
    "Robot says": saying(robot),
    "Server tick": tick ? `${tick.p50.toFixed(0)} ms` : "–",
  };
  $("facts").replaceChildren(
    ...Object.entries(facts).flatMap(([name, value]) => [element("dt", name), element("dd", value)]),
  );
}

/** What to tell the operator when the server has nothing special to say of the robot. */
function advice(robot) {
  const troubles = state.reasons.concat(state.warnings).join("; ");
  if (troubles) return troubles;
  if (robot.status === "stopped") return "Resume, then set a goal.";
  return robot.status === "no_goal" || robot.status === "arrived" ? HINT : "";
}

function ago(seconds) {
  return seconds === null ? "never" : seconds < 1 ? "just now" : `${seconds.toFixed(0)} s ago`;
}

/** What the robot says of itself; that it lacks a plan is no news while it is to have none. */
function saying({ status, robot_state: own }) {
  if (own === null) return "nothing yet";
  if (own.moving) return typeof own.v_mps === "number" ? `moving, ${Math.abs(own.v_mps).toFixed(1)} m/s` : "moving";
  const idle = status === "arrived" || status === "no_goal";
  return own.reason === null || (idle && /^(no )?plan /.test(own.reason)) ? "standing" : own.reason;
}

/** How well the server knows the camera, as far as it has learnt it from the robots. */
function calibrated({ status, progress, spread_2_m_cm: spread, event }) {
  const known = {
    unknown: "no robot seen yet",
    learning: `learning ${Math.floor(100 * progress)} %`,
    good: `good, ± ${Math.max(1, Math.round(spread))} cm at 2 m`,
  }[status];
  return event && status !== "good" ? `${known} – ${event}` : known;
}

function element(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

/** Call the API; throws an Error whose message is for the operator, with the `status` of a refusal. */
async function call(method, path, body) {
  const options = { method, signal: AbortSignal.timeout(4000) };
  if (body) {
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  const answer = await fetch(`api/v1/${path}`, options);
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const problem = await answer.json().catch(() => ({}));
  const error = new Error(problem.detail ?? problem.title ?? `The server answered ${answer.status}`);
  throw Object.assign(error, { status: answer.status });
}

async function act(method, path, body) {
  const robot = chosen();
  if (!robot) return;
  if (path === "resume") unheardStops.delete(robot);
  try {
    await tell(robot, method, path, body);
  } catch (error) {
    setText("message", error.message);
  }
}

async function tell(robot, method, path, body) {
  await call(method, `robots/${encodeURIComponent(robot)}/${path}`, body);
  setText("message", ""); // whether the robot has confirmed it stands in the state
}

/** Stop the chosen robot; where the server cannot be reached, again and again until it can. */
function stop() {
  const robot = chosen();
  if (!robot) return;
  const waiting = unheardStops.has(robot);
  unheardStops.add(robot);
  if (!waiting) insistOnStop(robot);
}

async function insistOnStop(robot) {
  if (!unheardStops.has(robot)) return;
  try {
    await tell(robot, "POST", "stop");
    unheardStops.delete(robot);
  } catch (error) {
    const refused = error.status >= 400 && error.status < 500;
    const again = refused ? "" : ". It is sent again until it does.";
    setText("message", `STOP HAS NOT GOT THROUGH: ${error.message}${again}`);
    if (refused) unheardStops.delete(robot);
    else setTimeout(() => insistOnStop(robot), STOP_AGAIN_MS);
  }
}

canvas.addEventListener("pointerdown", (event) => {
  pressed = event.isPrimary && event.button === 0 ? [event.clientX, event.clientY] : null;
});
canvas.addEventListener("pointercancel", () => (pressed = null));
canvas.addEventListener("pointerup", (event) => {
  if (!pressed || !state?.camera.size_px) return;
  const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
  pressed = null;
  const pixel = moved <= CLICK_PX ? pixelAt(event, canvas, state.camera.size_px) : null;
  if (pixel) act("PUT", "goal", pixel);
});
$("stop").addEventListener("click", stop);
$("resume").addEventListener("click", () => act("POST", "resume"));
$("drop").addEventListener("click", () => act("DELETE", "goal"));
$("robot").addEventListener("change", render);
window.addEventListener("resize", () => state && render());
// Capture, before a focused button takes the space bar for itself.
window.addEventListener("keydown", (event) => {
  if (event.code !== "Space") return;
  event.preventDefault();
  if (!event.repeat) stop();
}, true);
window.addEventListener("keyup", (event) => event.code === "Space" && event.preventDefault(), true);

const picture = $("picture");
const stream = () => (picture.src = `api/v1/stream.mjpg?since=${Date.now()}`);
picture.addEventListener("error", () => setTimeout(stream, 1000));
// The map is streamed only while it is looked at.
const map = $("map");
const mapStream = () => {
  if ($("map-box").open) map.src = `api/v1/stream.mjpg?layer=map&since=${Date.now()}`;
  else map.removeAttribute("src");
};
map.addEventListener("error", () => $("map-box").open && setTimeout(mapStream, 1000));
$("map-box").addEventListener("toggle", mapStream);
// A stream that ended shows its last picture without an error: begin anew when the server is back.
setInterval(() => {
  const quiet = isQuiet();
  if (wasQuiet && !quiet) {
    stream();
    mapStream();
  }
  if (wasQuiet !== quiet) render();
  wasQuiet = quiet;
}, 250);

stream();
listen();
pollWhileQuiet();
