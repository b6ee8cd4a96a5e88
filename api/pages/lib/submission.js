/** Sends what a form holds, once at a time. */

import { at } from "./draft.js";
import { useState } from "./html.js";

/**
 * @param {() => Promise<void>} send Rejects with the service's refusal.
 * @param {object} document What is sent.
 * @returns problem (the last refusal or null), errors (its places whose values have not been changed since),
 *   setProblem, isBusy, and submit, the form's listener. A form that was sent stays busy: its view is left.
 */
export function useSubmission(send, document) {
  const [problem, setProblem] = useState(null);
  const [sent, setSent] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    setSent(document);
    try {
      await send();
    } catch (refusal) {
      setProblem(refusal);
      setBusy(false);
    }
  };
  const isAsSent = ({ pointer }) => isSame(valueAt(sent, pointer), valueAt(document, pointer));
  return { problem, errors: (problem?.errors || []).filter(isAsSent), setProblem, isBusy, submit };
}

/** The value at a JSON pointer. */
const valueAt = (document, pointer) =>
  at(document, pointer.split("/").slice(1).map((name) => name.replaceAll("~1", "/").replaceAll("~0", "~")));

const isSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);
