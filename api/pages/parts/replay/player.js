/** A stage with its controls: play, scrub, speed, camera, and what is shown. */

import { html, useEffect, useRef, useState } from "../../lib/html.js";
import { Speeds } from "./speeds.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const FRAME_S = 1 / 50;
const isStill = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

/**
 * @param {object} shown scene, about (the header), episodes (loaded), key (changes with them), isBeside.
 * @param {number | null} start Seconds at which to begin, paused; null: play from the start.
 * @param {(time: number) => void} onPause Where somebody stopped.
 */
export function Player({ Stage, shown, start, name, options, setOption, onPause, children }) {
  const stageOf = useRef(null);
  const canvas = useRef();
  const frame = useRef();
  const [failure, setFailure] = useState(null);
  const [isFine, setFine] = useState(true); // Whether the machine draws shadows, where nobody said.
  const [time, setTime] = useState(start || 0);
  const [isPlaying, setPlaying] = useState(start === null && !isStill());
  const now = useRef(time);
  const { follow, contacts, shadows, ghost = true } = options;
  const seen = { follow, contacts, shadows, ghost };

  useEffect(() => {
    const picture = canvas.current; // A last one may be drawn after the element has left the page.
    const drawn = () => (picture.dataset.pictures = Number(picture.dataset.pictures || 0) + 1);
    try {
      stageOf.current = new Stage(picture, drawn);
      setFine(stageOf.current.quality === 0);
    } catch (error) {
      setFailure(error);
      return undefined;
    }
    return () => stageOf.current.dispose();
  }, []);

  useEffect(() => {
    const stage = stageOf.current;
    if (!stage) return;
    Object.assign(stage.options, seen);
    stage.setEpisodes(shown.scene, shown.about, shown.episodes, shown.isBeside);
    canvas.current.dataset.shown = shown.key;
    seek(Math.min(now.current, stage.duration));
  }, [shown.key]);

  useEffect(() => stageOf.current?.setOptions(seen), [follow, contacts, shadows, ghost]);

  const seek = (next) => {
    now.current = Math.min(Math.max(next, 0), stageOf.current.duration);
    stageOf.current.show(now.current);
    setTime(now.current);
  };

  // The motion is drawn with each of the browser's pictures; the slider follows ten times a second.
  useEffect(() => {
    if (!isPlaying || failure) return undefined;
    let last = null;
    let told = 0;
    const step = (at) => {
      const stage = stageOf.current;
      if (last !== null && !document.hidden) {
        now.current += ((at - last) / 1000) * options.speed;
        if (now.current > stage.duration) now.current = 0;
        stage.show(now.current);
        stage.pace(at - last);
        if (at - told > 100) {
          setTime(now.current);
          told = at;
        }
      }
      last = at;
      frame.current = requestAnimationFrame(step);
    };
    frame.current = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame.current);
  }, [isPlaying, options.speed, failure]);

  const pause = () => {
    setPlaying(false);
    setTime(now.current);
    onPause(now.current);
  };
  const toggle = () => (isPlaying ? pause() : setPlaying(true));
  const scrub = (next) => {
    setPlaying(false);
    seek(next);
    onPause(now.current);
  };
  const faster = (by) => setOption("speed", SPEEDS[Math.min(Math.max(SPEEDS.indexOf(options.speed) + by, 0), SPEEDS.length - 1)]);
  const keys = {
    " ": toggle,
    ArrowLeft: (event) => scrub(now.current - (event.shiftKey ? 1 : FRAME_S)),
    ArrowRight: (event) => scrub(now.current + (event.shiftKey ? 1 : FRAME_S)),
    Home: () => scrub(0),
    End: () => scrub(stageOf.current.duration),
    ",": () => faster(-1),
    ".": () => faster(1),
    "+": () => stageOf.current.zoom(0.85),
    "-": () => stageOf.current.zoom(1 / 0.85),
    q: () => stageOf.current.orbit(-10),
    e: () => stageOf.current.orbit(10),
    f: () => setOption("follow", !options.follow),
    c: () => setOption("contacts", !options.contacts),
    g: () => setOption("ghost", !ghost),
    r: () => stageOf.current.resetView(),
  };
  const press = (event) => {
    const act = !event.ctrlKey && !event.metaKey && !event.altKey && keys[event.key];
    if (!act) return;
    event.preventDefault();
    act(event);
  };
  const duration = Math.max(0, ...shown.episodes.map((episode) => episode.time.at(-1)));
  return html`<div class="replay">
    <div class="stage" tabindex="0" role="group" aria-label="${name}; keys are listed below" onKeyDown=${press}>
      <canvas ref=${canvas} role="img" aria-label=${name}></canvas>
      ${failure && html`<p class="state failure" role="alert">This browser draws nothing in three dimensions (it has no WebGL): ${failure.message}</p>`}
    </div>
    <div class="transport">
      <button type="button" class="main" onClick=${toggle} aria-label=${isPlaying ? "Pause" : "Play"}>${isPlaying ? "❚❚" : "►"}</button>
      <label class="slider">
        <span class="facts">${time.toFixed(2)} s of ${duration.toFixed(2)} s${returns(shown.episodes, time)}</span>
        <input type="range" min="0" max=${duration} step="0.01" value=${time} aria-label="Moment"
          aria-valuetext="${time.toFixed(2)} s" onInput=${(event) => scrub(Number(event.target.value))} />
      </label>
    </div>
    ${shown.episodes.length === 1 && shown.episodes[0].command && html`<${Speeds} ...${velocities(shown.episodes[0], time)} />`}
    <div class="tools" role="group" aria-label="How the replay is shown">
      ${children}
      <label>Speed
        <select value=${options.speed} onChange=${(event) => setOption("speed", Number(event.target.value))}>
          ${SPEEDS.map((speed) => html`<option value=${speed}>${speed} ×</option>`)}
        </select>
      </label>
      <label class="inline"><input type="checkbox" checked=${options.follow} onChange=${(event) => setOption("follow", event.target.checked)} /> Follow</label>
      <label class="inline"><input type="checkbox" checked=${options.contacts} onChange=${(event) => setOption("contacts", event.target.checked)} /> Contacts</label>
      ${shown.episodes.some((episode) => episode.reference_position) &&
      html`<label class="inline"><input type="checkbox" checked=${ghost} onChange=${(event) => setOption("ghost", event.target.checked)} /> Clip</label>`}
      <label class="inline"><input type="checkbox" checked=${shadows ?? isFine} onChange=${(event) => setOption("shadows", event.target.checked)} /> Shadows</label>
      <button type="button" onClick=${() => stageOf.current?.resetView()}>Reset the view</button>
    </div>
    <details><summary>Mouse, touch and keys</summary>
      <p class="facts">Drag to turn, with the right button or two fingers to move, wheel or pinch to come closer. With the picture
      in focus: space plays and pauses; ← → go by a frame, with shift by a second; , . change the speed; + − come closer and
      go away; q e turn; f follows; c shows contacts; g the clip that the body follows; r resets the view.</p>
    </details>
  </div>`;
}

/** The return of each episode until a moment. */
function returns(episodes, time) {
  const found = episodes.map((episode) => episode.return[frameAt(episode, time)].toFixed(1));
  return found.length > 4 ? "" : ` · return ${found.join(", ")}`;
}

/** The velocities of an episode's command and body at a moment. */
function velocities({ command, velocity, time: times }, time) {
  const first = 3 * frameAt({ time: times }, time);
  const [commanded, measured] = [command, velocity].map((values) => [...values.subarray(first, first + 3)]);
  return { commanded, measured };
}

const frameAt = (episode, time) => Math.max(episode.time.findLastIndex((at) => at <= time + 1e-6), 0);
