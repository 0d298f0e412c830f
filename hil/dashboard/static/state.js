// A night's state in one word, and its trouble in one sentence.

import { age, sentence } from "./words.js";

const GOOD = ["PASS"];

// Return [word, class] for the badge: green only where nothing is wrong.
export function stateOf(head) {
  if (head.killed) return ["controller dead", "dead"];
  if (head.working && troubleOf(head)?.bad) return [`${head.state}, in trouble`, "trouble"];
  const verdict = head.verdict && head.verdict.verdict;
  if (head.state === "complete" && head.in_spec?.verdict === "out of spec") return ["complete, out of spec", "failed"];
  if (head.state !== "complete" || !verdict || GOOD.includes(verdict)) return [head.state, head.state];
  return [`${head.state}, ${verdict}`, verdict === "FAIL" ? "failed" : "incomplete"];
}

// Return what must be said before anything else, or null.
export function troubleOf(head) {
  const problems = (head.problems || []).map(sentence).join(" · ");
  if (head.state === "unreadable") return { bad: true, text: `This night cannot be read: ${head.reason}` };
  if (head.reason.startsWith("ERROR: ")) return { bad: true, text: head.reason };
  if (head.working && head.old) {
    return {
      bad: head.age_s > 60 || Boolean(problems),
      text: [`The controller has shown nothing for ${age(head.age_s)}. What is below is that old.`, problems].filter(Boolean).join(" · "),
    };
  }
  if (problems) return { bad: true, text: problems };
  if (head.state === "failed") return { bad: true, text: `Failed: ${head.reason}` };
  if (head.state === "incomplete" && !head.working) return { bad: true, text: `Incomplete: ${head.reason}` };
  if (head.verdict && head.verdict.verdict === "FAIL") {
    return { bad: true, text: `FAIL: ${sentence(head.verdict.reason).split(";")[0]} must not be used` }; // the card says why
  }
  return null;
}

// Return who and what the night is about, in a few words.
export function identityOf(head) {
  const { model, serial, operator, note } = head.identity || {};
  return [[model, serial].filter(Boolean).join(" "), operator && `by ${operator}`, note].filter(Boolean).join(" · ");
}

// Return a link to the report that was made of a night, or null.
export function reportLink(id, head, reports) {
  if (!head.report) return null;
  const link = document.createElement("a");
  link.href = `${reports}${id.split("/").map(encodeURIComponent).join("/")}`;
  link.target = "_blank";
  link.rel = "noopener";
  link.className = "report";
  link.textContent = "Report";
  link.setAttribute("aria-label", `Report of ${id}`);
  return link;
}
