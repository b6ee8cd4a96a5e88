/** Clips of motion: upload a file, see what a worker found in it, and look at each as a replay. */

import { everyItem, get, remove, send, withQuery } from "../lib/api.js";
import { ago, bytes, count } from "../lib/format.js";
import { html, useEffect, useId, useRef, useState } from "../lib/html.js";
import { useLive } from "../lib/live.js";
import { change, href } from "../lib/route.js";
import { Confirm, Empty, Failure, Loading, Pages, Prose, Said } from "../parts/elements.js";
import { Player } from "../parts/replay/player.js";
import { ProjectChoice, whose } from "../parts/whose.js";

const IMITATE = "imitate"; // The task of an environment.
const LIMIT = 50;
const LONGEST_NAME = 100; // Characters, as the service allows.

export default function Clips({ query }) {
  const cursor = query.get("cursor");
  const { data, error, again } = useLive(
    (signal) => get("/clips", { cursor, limit: LIMIT }, { signal }),
    [cursor],
    (found) => (found.items.some(({ status }) => status === "validating") ? 1500 : 15_000),
  );
  const bodies = useLive(allBodies, []).data || [];
  return html`<div class="stack">
    <h1>Clips</h1>
    <${Upload} onAdded=${again} bodies=${bodies} />
    ${error && html`<${Failure} error=${error} again=${again} />`}
    ${!data && !error && html`<${Loading} what="clips" />`}
    ${data && !data.items.length && !cursor && html`<${Empty}><p>No clips yet. A clip is a recording of a body's motion, which a job imitates.</p><//>`}
    ${data && html`<div class="grid">${data.items.map((file) => html`<${File} key=${file.id} file=${file} query=${query} again=${again} canImitate=${bodies.some(({ id, canImitate }) => canImitate && id === file.body)} />`)}</div>`}
    ${data && html`<${Pages} path=${["clips"]} query=${query} next=${data.next} name="Pages of clips" first="Newest" more="Older clips" />`}
  </div>`;
}

function Upload({ onAdded, bodies }) {
  const [state, setState] = useState({});
  const [body, setBody] = useState("g1");
  const [rate, setRate] = useState("");
  const [project, setProject] = useState();
  const known = useId();
  const input = useRef();
  const upload = async (file) => {
    if (!file) return;
    setState({ text: `Sending ${file.name} (${bytes(file.size)}); a worker reads it…` });
    try {
      const path = withQuery("/clips", { name: file.name.slice(0, LONGEST_NAME), body: body.trim(), rate, project });
      const found = await (await send(path, { method: "POST", body: file, type: "application/octet-stream" })).json();
      setState({ text: `${file.name} ${found.status === "validating" ? "waits for a worker to read it; a busy one does so after its job." : "is there."}` });
    } catch (error) {
      setState({ error });
    }
    input.current.value = "";
    onAdded();
  };
  return html`<section class="drop" aria-label="Upload clips">
    <label class="field">Whose clips they are: an environment, or the id of a model of your own:
      <input value=${body} list=${known} onInput=${(event) => setBody(event.target.value)} />
    </label>
    <datalist id=${known}>${bodies.map(({ id, name }) => html`<option value=${id}>${name}</option>`)}</datalist>
    <label class="field">Frames per second, if the file does not say:
      <input type="number" min="0" step="any" value=${rate} onInput=${(event) => setRate(event.target.value)} />
    </label>
    <${ProjectChoice} value=${project} onChange=${setProject} />
    <label class="field">Choose a file of clips (NPZ, HDF5 or CSV; key points also in NWB, MATLAB, or a ZIP with points.json):
      <input ref=${input} type="file" accept=".npz,.h5,.hdf5,.csv,.nwb,.mat,.zip" onChange=${(event) => upload(event.target.files[0])} />
    </label>
    <p role="status">${state.text || ""}</p>
    ${state.error && html`<${Failure} error=${state.error} />`}
  </section>`;
}

/** The environments with a body of their own, and the models. canImitate: whether it has the task `imitate`. */
async function allBodies(signal) {
  const [environments, models] = await Promise.all([get("/environments", { family: "gaitway" }, { signal }), everyItem("/models", { signal })]);
  const named = environments.items.filter(({ id }) => id !== "mjcf").map(({ id, options }) => ({ id, name: id, canImitate: options.properties?.task?.enum?.includes(IMITATE) }));
  return [...named, ...models.filter(({ status }) => status === "ready").map(({ id, name }) => ({ id, name: name || id }))];
}

/** A job in which the clips' body follows them, and is tested on each. */
const imitatingJob = ({ id, body }) => ({
  kind: "train",
  environment: { id: body, options: { task: IMITATE, reference: { clips: [{ file: id }] } } },
  battery: true,
});

function File({ file, query, again, canImitate }) {
  const [error, setError] = useState(null);
  const { description: found } = file;
  const discard = () => remove(file.links.self).then(again, setError);
  const shown = query.get("show") === file.id;
  return html`<section class="card stack" aria-label=${file.name || file.id}>
    <h2>${file.name || file.id}</h2>
    <p class="facts"><span class="status ${file.status === "ready" ? "succeeded" : file.status === "refused" ? "failed" : ""}">${file.status}</span>
      ${` · ${file.body.slice(0, 20)} · ${bytes(file.size)} · ${ago(file.created_at)}${whose(file)}`}</p>
    <${Said} file=${file} />
    ${found && html`<${Listed} found=${found} />`}
    ${found?.no_replay && html`<p class="facts">There is no replay. ${found.no_replay}</p>`}
    ${file.links.replay && !shown && html`<p><button type="button" onClick=${() => change({ show: file.id, clip: [] })}>Look at them</button></p>`}
    ${shown && html`<${Replay} key=${file.id} file=${file} query=${query} />`}
    <p class="facts"><code>${file.id}</code></p>
    ${error && html`<${Failure} error=${error} />`}
    <p class="actions">
      ${found && canImitate && html`<a class="button" href=${href(["submit"], { job: JSON.stringify(imitatingJob(file)) })}>Train a policy to follow them</a>`}
      <a class=${found && canImitate ? "" : "button"} href=${file.links.file} download>Download</a>
      <${Confirm} text="Delete" question="Delete these clips?" onYes=${discard} isDangerous />
    </p>
  </section>`;
}

function Listed({ found }) {
  return html`<details open=${found.clips.length < 6}>
    <summary>${found.clips.length} ${found.clips.length === 1 ? "clip" : "clips"} (${found.format}), ${found.joints.length} joints</summary>
    <ul>${found.clips.map(
      (clip) => html`<li key=${clip.name}>${clip.name} <span class="facts">${count(clip.num_frames)} frames at ${clip.rate}/s, ${clip.seconds.toFixed(1)} s</span>
        ${clip.warnings.map((warning) => html`<p class="facts"><${Prose} text=${warning} /></p>`)}</li>`,
    )}</ul>
    ${found.key_points?.length > 0 && html`<p class="facts">${`Key points, and how far from the body they are on average: ${found.key_points.map(off).join(", ")}.`}</p>`}
  </details>`;
}

function off({ name, mean_distance: mean }) {
  return `${name} ${mean === null ? "not seen" : `${(mean * 1000).toFixed(1)} mm`}`;
}

/** Each clip is an episode of the file's replay. */
function Replay({ file, query }) {
  const number = Math.max(1, Number(query.get("clip")) || 1);
  // three.js and what uses it are loaded here, when a replay is opened.
  const modules = useLive(() => Promise.all([import("../lib/replay/stage.js"), import("../lib/replay/fetching.js")]), []);
  const opened = useRef(null);
  const [shown, setShown] = useState(null);
  const [error, setError] = useState(null);
  const [options, setOptions] = useState({ follow: true, contacts: false, shadows: null, speed: 1 });
  useEffect(() => {
    if (!modules.data) return undefined;
    const [, { loadScene, openReplay }] = modules.data;
    let isWanted = true;
    opened.current ??= Promise.all([loadScene(file.links.scene), openReplay(file.links.replay)]);
    opened.current
      .then(async ([scene, replay]) => ({ scene, about: replay.about, episodes: [await replay.episode(number - 1)], key: `${file.id} ${number}`, isBeside: false }))
      .then((found) => isWanted && setShown(found), (problem) => isWanted && setError(problem));
    return () => (isWanted = false);
  }, [modules.data, number]);
  if (modules.error || error) return html`<${Failure} error=${modules.error || error} />`;
  if (!shown) return html`<${Loading} what="the replay" />`;
  const clips = file.description.clips.slice(0, file.description.num_replayed);
  return html`<${Player} Stage=${modules.data[0].Stage} shown=${shown} start=${null} name="Replay of ${clips[number - 1].name}" options=${options}
    setOption=${(name, value) => setOptions({ ...options, [name]: value })} onPause=${() => undefined}>
    ${clips.length > 1 && html`<label>Clip
      <select aria-label="Clip" value=${number} onChange=${(event) => change({ clip: event.target.value }, true)}>
        ${clips.map(({ name }, index) => html`<option value=${index + 1}>${name}</option>`)}
      </select></label>`}
  <//>`;
}
