/** A job's policy at work in the browser, to be pushed (docs/push.md); of a running training always the newest. */

import { get, send } from "../../lib/api.js";
import { html, useRef } from "../../lib/html.js";
import { isOver } from "../../lib/job.js";
import { useLive } from "../../lib/live.js";
import { Pusher } from "../../parts/replay/pusher.js";
import { Empty, Loading, Prose } from "../../parts/elements.js";
import { canPush, policyOf, replaysOf } from "./replay.js";

export const PushTab = ({ job }) => html`<${Push} key=${job.id} job=${job} />`;

function Push({ job }) {
  const body = useLive((signal) => loadBody(job, signal), [canPush(job)]);
  const newest = useNewestPolicy(job);
  if (body.data?.refusal) return html`<${Empty}><p><${Prose} text=${body.data.refusal} /></p><//>`;
  const failed = [body, newest].find((one) => one.error);
  if (failed) return html`<${Empty}><p><${Prose} text=${failed.error.message} /></p><p><button type="button" onClick=${failed.again}>Try again</button></p><//>`;
  if (!body.data || !newest.policy) return html`<${Loading} what="the body" />`;
  return html`<section class="card" aria-label="Push">
    <${Pusher} ...${body.data} policy=${newest.policy} isTraining=${!isOver(job)} name="The trained body" />
  </section>`;
}

/** @returns {{policy: ArrayBuffer | null, error: Error | null, again: () => void}} The last one stays while a newer one comes. */
function useNewestPolicy(job) {
  const file = policyOf(job);
  const load = async (signal) => file && (await send(file.href, { signal })).arrayBuffer();
  const { data, error, again } = useLive(load, [file?.sha256]);
  const last = useRef(null);
  last.current = data || last.current;
  return { policy: last.current, error: last.current ? null : error, again };
}

async function loadBody(job, signal) {
  const recipe = await get(`/jobs/${job.id}/simulation`, {}, { signal });
  if (recipe.refusal) return recipe;
  const replay = replaysOf(job).at(-1);
  if (!replay || !policyOf(job)) return { refusal: whyNotYet(job) };
  // three.js and what uses it are loaded here; MuJoCo by the worker.
  const [{ Stage }, { loadScene, openReplay }, { Handle }, physics, steering, terrain] = await Promise.all([
    import("../../lib/replay/stage.js"),
    import("../../lib/replay/fetching.js"),
    import("../../lib/push/handle.js"),
    import("../../lib/push/body.js"),
    import("../../lib/push/steering.js"),
    import("../../lib/push/terrain.js"),
  ]);
  const [scene, { about }] = await Promise.all([loadScene(`/jobs/${job.id}/replay/scene`), openReplay(replay.href, signal)]);
  return { modules: { Stage, Handle, ...physics, ...steering, ...terrain }, shown: { scene, about, recipe } };
}

/** Of a job that lacks its replay, which has the body's looks, or its policy for the page. */
const whyNotYet = (job) =>
  isOver(job) || job.spec.video === null
    ? "This job has no replay, which has the body's looks, or no policy for the page: its video is null, or its events say why."
    : "The body is here as soon as the training has its first replay.";
