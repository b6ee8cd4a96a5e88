/** Sends what a form holds, once at a time. */

import { useState } from "./html.js";

/**
 * @param {() => Promise<void>} send Rejects with the service's refusal.
 * @returns problem (the last refusal or null), setProblem, isBusy, and submit, the form's listener. A form that was
 *   sent stays busy: its view is left.
 */
export function useSubmission(send) {
  const [problem, setProblem] = useState(null);
  const [isBusy, setBusy] = useState(false);
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    try {
      await send();
    } catch (refusal) {
      setProblem(refusal);
      setBusy(false);
    }
  };
  return { problem, setProblem, isBusy, submit };
}
