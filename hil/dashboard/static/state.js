// A night's state in one word, and its trouble in one sentence.

import { age } from "./words.js";

// Return [word, class] for the badge.
export function stateOf(head) {
  if (head.killed) return ["controller dead", "dead"];
  return [head.state, head.state];
}

// Return what must be said before anything else, or null.
export function troubleOf(head) {
  if (head.state === "unreadable") return { bad: true, text: `This night cannot be read: ${head.reason}` };
  if (head.killed) {
    return {
      bad: true,
      text: "The controller is dead: it was killed, or lost its power. The chamber may still be conditioning; hil watchdog makes it safe, hil resume carries on.",
    };
  }
  if (head.reason.startsWith("ERROR: ")) return { bad: true, text: head.reason };
  if (head.working && head.old) {
    return {
      bad: head.age_s > 60,
      text: `The controller has shown nothing for ${age(head.age_s)}. What is below is that old.`,
    };
  }
  if (head.state === "failed") return { bad: true, text: `Failed: ${head.reason}` };
  return null;
}
