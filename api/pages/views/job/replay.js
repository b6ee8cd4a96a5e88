/** A job's replay in three dimensions: which checkpoint, which episodes; all of it in the address. */

import { get } from "../../lib/api.js";
import { count } from "../../lib/format.js";
import { html, useEffect, useState } from "../../lib/html.js";
import { isOver, ofSeed } from "../../lib/job.js";
import { useLive } from "../../lib/live.js";
import { change } from "../../lib/route.js";
import { Player } from "../../parts/replay/player.js";
import { Empty, Failure, Loading } from "../../parts/elements.js";

const MOST_AT_ONCE = 8;

/** The newest policy in the form that the page runs. */
export const policyOf = (job) => ofSeed(job).artifacts.find((file) => /^policy(-seed-\d+)?\.npz$/.test(file.name));

/** Whether the page can step the job's body itself, so that it may be pushed; also while the job trains. */
export const canPush = (job) =>
  job.artifacts.some((file) => file.role === "simulation" && file.metadata.can_run) && Boolean(policyOf(job)) && replaysOf(job).length > 0;

/** Whether the job's body follows commands, so that it may be steered. */
export const canDrive = (job) => canPush(job) && job.artifacts.some((file) => file.role === "simulation" && file.metadata.follows_commands);

/** The job's replays by step; that of a rollout has no step. */
export const replaysOf = (job) =>
  ofSeed(job).artifacts.filter((file) => file.role === "replay").sort((a, b) => (a.step ?? Infinity) - (b.step ?? Infinity));

export function ReplayTab({ job, query }) {
  const files = replaysOf(job);
  const asked = query.get("step");
  const found = asked === null ? files.at(-1) : files.find((file) => String(file.step) === asked);
  if (!found) return html`<${NoReplay} job=${job} step=${asked} />`;
  return html`<section class="card" aria-label="Replay">
    <${Loaded} job=${job} files=${files} file=${found} query=${query} />
  </section>`;
}

/** The newest replay, for a view of something else; nothing without one. */
export function NewestReplay({ job, query }) {
  const files = replaysOf(job);
  return files.length > 0 && html`<${Loaded} job=${job} files=${files} file=${files.at(-1)} query=${query} isAlone />`;
}

/** Why there is none, in the service's words. */
function NoReplay({ job, step }) {
  const { error } = useLive((signal) => get(`/jobs/${job.id}/replay`, { step, seed: job.shownSeed }, { signal }), [job.id, step, job.artifacts.length]);
  return html`<${Empty}>
    <p>${error ? error.message : "Looking for a replay…"}</p>
    ${!isOver(job) && html`<p>It appears here as soon as it is there.</p>`}
    ${step !== null && html`<p><a href="#/jobs/${job.id}/replay">To the newest</a></p>`}
  <//>`;
}

function Loaded({ job, files, file, query, isAlone }) {
  // three.js and what uses it are loaded here, when a replay is opened.
  const modules = useLive(() => Promise.all([import("../../lib/replay/stage.js"), import("../../lib/replay/fetching.js")]), []);
  const numbers = query.getAll("episode").map(Number).filter((number) => number >= 1).slice(0, MOST_AT_ONCE);
  const isBeside = query.get("beside") === "1";
  const wanted = numbers.length ? numbers : [1];
  const [shown, setShown] = useState(null);
  const [error, setError] = useState(null);
  const key = `${file.sha256} ${wanted} ${isBeside}`;
  const [start] = useState(query.get("t") === null ? null : Number(query.get("t")) || 0);
  const [again, setAgain] = useState(0);
  useEffect(() => {
    if (!modules.data) return undefined;
    const control = new AbortController();
    load(modules.data, job, file, wanted, control.signal).then(
      (loaded) => !control.signal.aborted && (setShown({ ...loaded, key, isBeside, step: file.step }), setError(null)),
      (problem) => control.signal.aborted || setError(problem),
    );
    return () => control.abort();
  }, [key, modules.data, again]);
  const failure = modules.error || error;
  if (failure) return html`<${Failure} error=${failure} again=${() => (modules.again(), setAgain(again + 1))} />`;
  if (!shown) return html`<${Loading} what="the replay" />`;
  const options = {
    follow: query.get("follow") !== "0",
    contacts: query.get("contacts") === "1",
    ghost: query.get("ghost") !== "0",
    shadows: { 0: false, 1: true }[query.get("shadows")] ?? null,
    speed: Number(query.get("speed")) || 1,
  };
  const said = { follow: (on) => (on ? [] : "0"), contacts: (on) => (on ? "1" : []), ghost: (on) => (on ? [] : "0"), shadows: (on) => (on ? "1" : "0"), speed: (speed) => (speed === 1 ? [] : speed) };
  const setOption = (name, value) => change({ [name]: said[name](value) }, true);
  const name = `Replay of ${shown.numbers.length > 1 ? "episodes" : "episode"} ${shown.numbers.join(", ")}${at(shown.step)}`;
  return html`
    <${Player} Stage=${modules.data[0].Stage} shown=${shown} start=${start} name=${name} options=${options}
      setOption=${setOption} onPause=${(time) => change({ t: time.toFixed(2) }, true)}>
      <${Episodes} about=${shown.about} chosen=${wanted} isBeside=${isBeside} />
    <//>
    ${isAlone ? html`<p class="facts">${subject(file, "The policy")}${at(file.step)}</p>` : html`<${Steps} files=${files} file=${file} />`}
    ${canPush(job) && html`<p><a href="#/jobs/${job.id}/push">${canDrive(job) ? "Drive it with the keyboard, and push it" : "Push it, and see whether it recovers"}</a></p>`}
  `;
}

/** A training keeps the last states of the first body that an engine lost, too. */
const subject = (file, policy) => (file.metadata.lost_body ? "A body that was lost" : policy);

const at = (step) => (step === null ? "" : ` at step ${count(step)}`);

/** The scene is the same for all of a job's replays. */
const scenes = new Map();

async function load([, { loadScene, openReplay }], job, file, wanted, signal) {
  const address = `/jobs/${job.id}/replay/scene`;
  const { sha256 } = job.artifacts.find((one) => one.role === "scene") || {};
  const known = `${job.id} ${sha256}`;
  if (!scenes.has(known)) {
    scenes.clear();
    scenes.set(known, loadScene(address));
    scenes.get(known).catch(() => scenes.delete(known));
  }
  const [scene, replay] = await Promise.all([scenes.get(known), openReplay(file.href, signal)]);
  const { about } = replay;
  const numbers = wanted.filter((number) => number <= about.episodes.length);
  if (!numbers.length) numbers.push(1);
  const episodes = await Promise.all(numbers.map((number) => replay.episode(number - 1)));
  return { scene, about, episodes, numbers };
}

/** Which episodes are shown, if there are several. */
function Episodes({ about, chosen, isBeside }) {
  const all = about.episodes;
  if (all.length < 2) return null;
  const toggle = (number) => {
    const next = chosen.includes(number) ? chosen.filter((one) => one !== number) : [...chosen, number].sort((a, b) => a - b);
    change({ episode: next.length ? next : [1] }, true);
  };
  return html`
    <details class="episodes"><summary>Episodes ${chosen.join(", ")} of ${all.length}</summary>
      <ul>${all.map(
        (episode, index) => html`<li key=${index}><label class="inline">
          <input type="checkbox" checked=${chosen.includes(index + 1)} onChange=${() => toggle(index + 1)}
            disabled=${!chosen.includes(index + 1) && chosen.length >= MOST_AT_ONCE} />
          ${index + 1} <span class="facts">${episode.duration_s.toFixed(1)} s${episode.terminated ? ", ended early" : ""}</span>
        </label></li>`,
      )}</ul>
    </details>
    ${chosen.length > 1 &&
    html`<label class="inline"><input type="checkbox" checked=${isBeside} onChange=${(event) => change({ beside: event.target.checked ? "1" : [] }, true)} /> Side by side</label>`}
  `;
}

/** A slider through the checkpoints that have a replay; at its end it stays with the newest. */
function Steps({ files, file }) {
  if (files.length < 2) return null;
  const place = files.indexOf(file);
  const choose = (event) => {
    const next = Number(event.target.value);
    change({ step: next === files.length - 1 ? [] : String(files[next].step) }, true);
  };
  return html`<label class="slider">
    <span class="facts">${subject(file, "Policy")}${at(file.step)} (${place + 1} of ${files.length})</span>
    <input type="range" min="0" max=${files.length - 1} value=${place} onInput=${choose} aria-label="Checkpoint" aria-valuetext="step ${count(file.step ?? 0)}" />
  </label>`;
}
