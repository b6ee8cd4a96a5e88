/** A job's events as they happen (server-sent events), across losses of the connection. */

import { report, signedOut } from "./api.js";

const KINDS = ["status", "progress", "metrics", "artifact", "phase", "note"];
const FINAL = new Set(["succeeded", "failed", "cancelled"]);
const PAUSE_MS = 2000;

export const isFinal = (status) => FINAL.has(status);

/**
 * Follow a job's events until its end.
 *
 * A browser reconnects by itself, with Last-Event-ID, after a lost connection; after a refusal (a restart in
 * front of which a proxy answers 502) it does not, so then a new stream begins after the last event seen.
 * @param {string} path Of the events.
 * @param {string} after The id of the last event that is known already.
 * @param {(kind: string, data: object, time: string, number: string) => void} onEvent number: its id.
 * @param {() => void} onEnd Called once: the job has ended, or is no longer there.
 * @returns {() => void} Stops it.
 */
export function follow(path, after, onEvent, onEnd) {
  let last = after;
  let source;
  let timer;
  const pause = () => {
    clearTimeout(timer);
    source?.close();
  };
  // Browsers allow six connections to a service: pages that nobody sees leave them to others.
  const onVisible = () => (document.hidden ? pause() : (pause(), open()));
  const stop = () => {
    document.removeEventListener("visibilitychange", onVisible);
    pause();
  };
  const end = () => {
    stop();
    onEnd();
  };
  const open = () => {
    source = new EventSource(last ? `${path}?after=${last}` : path);
    source.onopen = () => report(true);
    source.onerror = async () => {
      if (source.readyState === EventSource.CONNECTING) return report(false);
      // Closed: by 204 or 404 for good, by anything else for a while.
      const there = await fetch(path.replace(/\/events$/, "")).catch(() => null);
      report(there !== null);
      if (there?.status === 401) signedOut();
      if (there?.status === 404 || (there?.ok && isFinal((await there.json()).status))) return end();
      if (!document.hidden) timer = setTimeout(open, PAUSE_MS);
    };
    for (const kind of KINDS) {
      source.addEventListener(kind, (event) => {
        last = event.lastEventId || last;
        const { time, data } = JSON.parse(event.data);
        onEvent(kind, data, time, event.lastEventId);
        if (kind === "status" && isFinal(data.status)) end();
      });
    }
  };
  document.addEventListener("visibilitychange", onVisible);
  if (!document.hidden) open();
  return stop;
}
