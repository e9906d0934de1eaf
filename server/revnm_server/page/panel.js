// The panel beside the picture: the robots, what the chosen one does and why, and how long things take.

import { drawInset, insetCaption } from "./inset.js";

export const STATUS = {
  no_goal: "No goal",
  driving: "Driving",
  arrived: "Arrived",
  stopped: "Stopped",
  waiting: "Waiting",
  standing: "Standing",
};
const HINT = "Click or tap in the picture to send the robot there.";
const LEAST_SCALE_MS = 100;
const STAGES = ["depth", "tag", "map", "exo2ego", "policy", "learn", "tick"];

export const $ = (id) => document.getElementById(id);

/** Set a text where it has changed: screen readers repeat what is set again. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** What a robot does, and why. A robot that is led but says why it stands, stands. */
export function doing(robot, state) {
  const own = /^robot: (.*)/.exec(robot.reason ?? "")?.[1];
  if (robot.status === "driving" && own) return { kind: "standing", reason: own };
  return { kind: robot.status, reason: robot.reason ?? advice(robot, state) };
}

/** Show the robots as a list where there are several; `choose(name)` is called when another is chosen. */
export function showRobots(state, { chosen, quiet, choose }) {
  const list = $("robots");
  list.hidden = state.robots.length < 2;
  const cards = rows(list, "label", state.robots.map((robot) => robot.name), (card, name) => {
    const input = Object.assign(document.createElement("input"), { type: "radio", name: "robot", value: name });
    input.addEventListener("change", () => choose(name));
    card.append(input, element("span", name, "name"), element("span", "", "tag"));
  });
  state.robots.forEach((robot, i) => {
    const [input, , tag] = cards[i].children;
    const { kind } = doing(robot, state);
    if (input.checked !== (robot.name === chosen)) input.checked = robot.name === chosen;
    setText(tag, quiet ? "No contact" : STATUS[kind]);
    tag.className = `tag ${quiet ? "unknown" : kind}`;
  });
}

/** Show all there is of the chosen robot; `may` says whether the operator may send it anywhere. */
export function showRobot(robot, state, { quiet, may }) {
  const { kind, reason } = doing(robot, state);
  setText($("status"), quiet ? "No contact" : STATUS[kind]);
  $("status").className = `status ${quiet ? "unknown" : kind}`;
  setText($("reason"), quiet ? "A robot that gets no plans stands by itself." : !may && reason === HINT ? "" : reason);
  const several = state.robots.length > 1;
  setText($("stop-text"), several ? `Stop ${robot.name}` : "Stop");
  $("stop-all").hidden = !several;
  $("resume").hidden = !may || robot.status !== "stopped";
  $("drop").hidden = !may || robot.goal === null;
  $("watching").hidden = may;
  drawInset($("inset"), robot, state.robot_size_m, quiet);
  setText($("inset-caption"), insetCaption(robot, quiet));
  showFacts(robot, state);
  showBars(robot, state);
}

/** What to tell the operator when the server has nothing special to say of the robot. */
function advice(robot, state) {
  const troubles = state.reasons.concat(state.warnings).join("; ");
  if (troubles) return troubles;
  if (robot.status === "stopped") return "Resume, then set a goal.";
  return robot.status === "no_goal" || robot.status === "arrived" ? HINT : "";
}

function showFacts(robot, state) {
  const { fps, frame_age_s: age, calibration } = state.camera;
  const facts = {
    "Robot says": saying(robot),
    "Robot seen": ago(robot.sighting_age_s),
    "Robot heard": ago(robot.robot_state_age_s),
    "Plan": robot.plan_age_s === null ? "none yet" : ago(robot.plan_age_s),
    "Clocks apart": milliseconds(robot.clock_offset_ms === null ? null : Math.abs(robot.clock_offset_ms)),
    "Picture": age === null ? "none yet" : `${ago(age)}${fps ? `, ${fps.toFixed(0)} fps` : ""}`,
    ...(calibration && { "Calibration": calibrated(calibration) }),
  };
  const made = rows($("facts"), "div", Object.keys(facts), (row, name) => {
    row.append(element("dt", name), element("dd", ""));
  });
  Object.values(facts).forEach((value, i) => setText(made[i].lastChild, value));
}

/** Bars: the median, and a lighter one as far as 95 % go. */
function showBars(robot, state) {
  const stages = STAGES.filter((stage) => state.timings_ms[stage]).map((stage) => [stage, state.timings_ms[stage]]);
  const trip = robot.round_trip_ms === null ? null : { p50: robot.round_trip_ms, p95: robot.round_trip_ms };
  const known = [["picture → plan", robot.picture_to_plan_ms], ...stages, ["robot and back", trip]];
  const all = known.filter(([, timing]) => timing);
  const scale = Math.max(LEAST_SCALE_MS, ...all.map(([, timing]) => timing.p95));
  const made = rows($("bars"), "tr", all.map(([name]) => name), (row, name) => {
    const bar = element("td", "", "bar");
    bar.append(element("i", "", "p95"), element("i", "", "p50"));
    row.append(Object.assign(element("th", name), { scope: "row" }), bar, element("td", ""));
  });
  all.forEach(([, { p50, p95 }], i) => {
    const [, bar, words] = made[i].children;
    bar.firstChild.style.width = `${(100 * p95) / scale}%`;
    bar.lastChild.style.width = `${(100 * p50) / scale}%`;
    setText(words, p50 === p95 ? milliseconds(p50) : `${p50.toFixed(0)}, ${milliseconds(p95)}`);
  });
}

function milliseconds(value) {
  return value === null ? "–" : `${value < 10 ? value.toFixed(1) : value.toFixed(0)} ms`;
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

/** The rows of a container, one a name, made anew by `fill(row, name)` only where the names have changed. */
function rows(container, tag, names, fill) {
  const key = names.join("\n");
  if (container.dataset.rows !== key) {
    container.dataset.rows = key;
    for (const old of [...container.children]) if (old.tagName !== "LEGEND") old.remove();
    for (const name of names) fill(container.appendChild(document.createElement(tag)), name);
  }
  return [...container.children].filter((child) => child.tagName !== "LEGEND");
}

function element(tag, text, kind = "") {
  return Object.assign(document.createElement(tag), { textContent: text, className: kind });
}
