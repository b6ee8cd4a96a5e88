/** A replay and its scene from the service. */

import { send } from "../api.js";
import { readReplay } from "./file.js";
import { readScene } from "./scene.js";

/** The replay at an address; what it needs of it is fetched. Raises Problem, Away, or Error if it is no replay. */
export const openReplay = (href, signal) => readReplay((first, last) => part(href, first, last, signal));

/** The scene's root at an address. Raises Problem, Away, or Error if it is no glTF. */
export const loadScene = async (href) => readScene(await (await send(href)).arrayBuffer());

/** Bytes [first, last] of a file, also where the service sends all of it. */
async function part(href, first, last, signal) {
  const answer = await send(href, { signal, range: [first, last] });
  const bytes = await answer.arrayBuffer();
  return answer.status === 206 ? bytes : bytes.slice(first, last + 1);
}
