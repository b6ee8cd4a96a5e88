/** A stage with a body that lives: its policy moves it, and whoever looks may push it, and steer it if it follows commands. */

import { count } from "../../lib/format.js";
import { html, useEffect, useRef, useState } from "../../lib/html.js";
import { GroundChoice } from "./ground_choice.js";
import { Speeds } from "./speeds.js";

const PUSH_MS = 200;
const LONGEST_PICTURE_MS = 500; // After a longer break nothing was drawn.
const STRENGTHS = [0.25, 0.5, 1, 2];
const SIDES = { left: [-1, 0], right: [1, 0], away: [0, 1], closer: [0, -1] };
const PUSHES = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "away", ArrowDown: "closer" };
const ARROWS = { left: "←", right: "→", away: "↑", closer: "↓" };
/** What each button tells a body that follows commands, in the order of a keyboard. */
const PAD = [
  ["KeyQ", "↺", "Turn left"],
  ["KeyW", "▲", "Walk forward"],
  ["KeyE", "↻", "Turn right"],
  ["KeyA", "◀", "Walk left"],
  ["KeyS", "▼", "Walk back"],
  ["KeyD", "▶", "Walk right"],
];
const isStill = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/**
 * @param {object} modules Stage, Handle, LiveMotion, Steering, KEYS of steering, episodeOf, startPhysics, firstLayout, partsOf.
 * @param {object} shown scene, about (a replay's header), recipe.
 * @param {ArrayBuffer} policy The one that acts; another takes its place while the body moves.
 * @param {boolean} isTraining Whether newer policies may come.
 */
export function Pusher({ modules, shown, policy, name, isTraining }) {
  const canvas = useRef();
  const parts = useRef({});
  const [failure, setFailure] = useState(null);
  const [phase, setPhase] = useState("starting");
  const [story, setStory] = useState("MuJoCo is loaded (2.5 MB)…");
  const [time, setTime] = useState(0);
  const [trainedSteps, setTrainedSteps] = useState(null);
  const [isRunning, setRunning] = useState(!isStill());
  const [strength, setStrength] = useState(0.5);
  const ranges = shown.recipe.command || [];
  const isSteered = ranges.length > 0;
  const [speeds, setSpeeds] = useState(null);
  const { terrain } = shown.recipe;
  const [layout, setLayout] = useState(terrain ? modules.firstLayout(terrain) : null);

  useEffect(() => {
    const { about, recipe } = shown;
    const picture = canvas.current; // A last one may be drawn after the element has left the page.
    const motion = new modules.LiveMotion(about);
    let news = null; // What the worker said last, until it is drawn.
    let last = 0;
    let told = 0;
    let slow = 0;
    const hear = (said) => {
      if (said.trainedSteps !== undefined) return setTrainedSteps(said.trainedSteps);
      if (said.fell !== undefined) return setStory(`It fell, or left its range, after ${said.fell.toFixed(1)} s; it starts again.`);
      if (!motion.positions) begin(said);
      motion.take(said);
      slow = said.isSlow ? slow + 1 : 0;
      if (slow === 30) setStory("This machine is slower than real time.");
      news = said;
    };
    const begin = (said) => {
      motion.take(said);
      const { stage } = parts.current;
      stage.setEpisodes(shown.scene, about, [modules.episodeOf(motion, terrain ? modules.partsOf(terrain, layout) : [])], false);
      parts.current.handle = new modules.Handle(stage, (pull) => parts.current.physics.say({ pull }));
      setPhase("ready");
      // So that keys steer at once, unless somebody is elsewhere on the page already.
      if (document.activeElement === document.body) picture.parentElement.focus({ preventScroll: true });
      setStory(isSteered ? "Steer it with W A S D, Q and E; take hold of the body and pull." : "Take hold of the body and pull.");
    };
    const steering = new modules.Steering(ranges);
    parts.current.steering = steering;
    let asked = [];
    const steer = () => {
      const command = steering.command();
      if (command.every((part, i) => part === asked[i])) return;
      asked = command;
      parts.current.physics.say({ command });
    };
    // With each of the browser's pictures, so that the stage learns how long they take.
    const draw = (at) => {
      parts.current.frame = requestAnimationFrame(draw);
      if (isSteered) steer();
      if (!news) return;
      const { stage, handle } = parts.current;
      handle.show(news.force, news.weight);
      stage.show(news.time);
      if (at - last < LONGEST_PICTURE_MS) stage.pace(at - last);
      last = at;
      Object.assign(picture.dataset, { time: news.time, position: motion.position(about.bodies.indexOf(recipe.tracked_body)).join(" ") });
      if (at - told > 100) {
        setTime(news.time);
        if (isSteered) setSpeeds({ commanded: news.command, measured: news.motion });
        told = at;
      }
      news = null;
    };
    try {
      const drawn = () => (picture.dataset.pictures = Number(picture.dataset.pictures || 0) + 1);
      parts.current.stage = new modules.Stage(picture, drawn);
      parts.current.physics = modules.startPhysics(recipe, policy, hear, setFailure);
      parts.current.policy = policy;
      parts.current.frame = requestAnimationFrame(draw);
    } catch (error) {
      setFailure(error);
    }
    return () => {
      const { stage, handle, physics, frame } = parts.current;
      cancelAnimationFrame(frame);
      for (const part of [handle, stage]) part?.dispose();
      physics?.end();
      clearTimeout(parts.current.release);
    };
  }, []);

  useEffect(() => {
    if (phase !== "ready" || parts.current.policy === policy) return;
    parts.current.policy = policy;
    parts.current.physics.say({ policy });
  }, [policy, phase]);

  // Nobody sees a hidden page, so nothing moves there.
  useEffect(() => {
    const run = () => parts.current.physics?.say({ run: isRunning && !document.hidden });
    if (phase === "ready") run();
    document.addEventListener("visibilitychange", run);
    return () => document.removeEventListener("visibilitychange", run);
  }, [isRunning, phase]);

  const say = (what) => parts.current.physics?.say(what);
  const push = (side) => {
    const force = parts.current.handle?.onTheGround(SIDES[side]).map((part) => part * strength);
    if (!force) return;
    say({ pull: { body: shown.recipe.tracked_body, force } });
    setStory(`It was pushed: ${side}.`);
    clearTimeout(parts.current.release);
    parts.current.release = setTimeout(() => say({ pull: null }), PUSH_MS);
  };
  const restart = () => (say({ reset: true }), setStory("It starts again."));
  const choose = (number) => {
    setLayout(number);
    parts.current.stage.figures[0].move(modules.partsOf(terrain, number));
    say({ layout: number, reset: true });
    setStory("It starts on this ground.");
    canvas.current.parentElement.focus({ preventScroll: true }); // So that keys steer again.
  };
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    // A control in focus keeps the keys that it knows; letters steer from everywhere else.
    const { code, key, target } = event;
    if (target.matches("select") || (!target.matches(".stage") && (key === " " || code.startsWith("Arrow")))) return;
    const steers = isSteered && !event.shiftKey && modules.KEYS[event.code] && (() => parts.current.steering.press(event.code));
    const pushes = PUSHES[event.key] && !event.repeat && (() => push(PUSHES[event.key]));
    const act = { " ": () => setRunning(!isRunning), r: restart }[event.key] || steers || pushes;
    if (!act) return;
    event.preventDefault();
    act();
  };
  const release = (event) => parts.current.steering?.release(event.code);
  const letGo = (event) => event.currentTarget.contains(event.relatedTarget) || parts.current.steering?.releaseAll();
  return html`<div class="replay push" onKeyDown=${press} onKeyUp=${release} onFocusOut=${letGo}>
    <div class="stage" tabindex="0" role="group" aria-label="${name}; keys are listed below">
      <canvas ref=${canvas} role="img" aria-label=${name}></canvas>
      ${failure && html`<p class="state failure" role="alert">${failure.message}</p>`}
    </div>
    <div class="transport">
      <button type="button" class="main" disabled=${Boolean(failure)} onClick=${() => setRunning(!isRunning)} aria-label=${isRunning ? "Pause" : "Play"}>${isRunning ? "❚❚" : "►"}</button>
      <p><span role="status">${failure ? "" : story}</span> <span class="facts">${time.toFixed(1)} s</span></p>
    </div>
    ${trainedSteps !== null && html`<p class="facts">Policy at step ${count(trainedSteps)}${isTraining ? "; the training's next one takes its place as soon as it is here" : ""}</p>`}
    ${isSteered && html`<div class="steering">
      <${Pad} isReady=${phase === "ready"} steering=${() => parts.current.steering} />
      <${Speeds} ranges=${ranges} ...${speeds || { commanded: ranges.map(() => 0), measured: ranges.map(() => 0) }} />
    </div>`}
    <div class="tools" role="group" aria-label="Pushing">
      ${Object.keys(SIDES).map((side) => html`<button type="button" disabled=${phase !== "ready"} onClick=${() => push(side)} aria-label="Push it ${side}">${ARROWS[side]}</button>`)}
      <label>Strength
        <select value=${strength} onChange=${(event) => setStrength(Number(event.target.value))}>
          ${STRENGTHS.map((one) => html`<option value=${one}>${one} × its weight</option>`)}
        </select>
      </label>
      ${terrain && html`<${GroundChoice} layouts=${terrain.layouts} chosen=${layout} isReady=${phase === "ready"} choose=${choose} />`}
      <button type="button" disabled=${phase !== "ready"} onClick=${restart}>Start again</button>
      <button type="button" onClick=${() => parts.current.stage?.resetView()}>Reset the view</button>
    </div>
    <details><summary>Mouse, touch and keys</summary>
      <p class="facts">Drag the body to pull it, and beside it to turn the picture; drag with the right button or two fingers to move,
      wheel or pinch to come closer. Keys: ${
        isSteered
          ? "W and S or ↑ and ↓ walk forward and back, A and D or ← and → to the sides, Q and E turn; Shift with an arrow pushes it for 0.2 s"
          : "← → ↑ ↓ push it for 0.2 s"
      }, as seen from here; space pauses; r starts again.${isSteered ? " Of a gamepad, the left stick walks and the right one turns." : ""}</p>
    </details>
  </div>`;
}

/** Buttons that steer while they are held. */
function Pad({ isReady, steering }) {
  const isPress = ({ key }) => key === " " || key === "Enter";
  return html`<div class="pad" role="group" aria-label="Steering">${PAD.map(([code, sign, name]) => {
    const press = () => steering()?.press(code);
    const release = () => steering()?.release(code);
    const take = (event) => (event.preventDefault(), event.currentTarget.setPointerCapture(event.pointerId), press());
    return html`<button key=${code} type="button" disabled=${!isReady} aria-label=${name} title="${name}: ${code.slice(-1)}"
      onPointerDown=${take} onPointerUp=${release} onPointerCancel=${release} onBlur=${release} onContextMenu=${(event) => event.preventDefault()}
      onKeyDown=${(event) => isPress(event) && (event.preventDefault(), press())} onKeyUp=${release}>${sign}</button>`;
  })}</div>`;
}
