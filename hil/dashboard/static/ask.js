// Asking the controller for something: what it means, who asks, the token, and only then the request.

const TEXTS = {
  pause: ["Pause the night?", "The chamber is held where it is until somebody continues. A collect that is being taken is finished or redone; nothing is lost.", "Pause"],
  continue: ["Go on with the night?", "The devices are checked and the unit is positioned again. The soak starts over where its band was not held.", "Continue"],
  abort: ["Abort the night?", "The chamber is brought to its safe state and the night ends. What is done stays done: hil resume carries it on later.", "Abort the night"],
  confirm: ["Confirm?", "", "Confirm"],
  refuse: ["Refuse?", "", "Refuse"],
};

const DOUBLE_CLICK_MS = 500;

const $ = (id) => document.getElementById(id);

export class Asking {
  constructor(stream, say) {
    this.stream = stream;
    this.say = say;
    this.request = null;
    $("ask-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.send();
    });
    $("ask-no").addEventListener("click", () => $("ask").close());
  }

  open(night, kind, prompt = null) {
    const [title, text, yes] = TEXTS[kind];
    this.request = { night, kind, prompt: prompt ? prompt.prompt : null };
    $("ask-title").textContent = title;
    $("ask-text").textContent = prompt ? prompt.question : text;
    $("ask-yes").textContent = yes;
    $("ask-yes").classList.toggle("danger", kind === "abort" || kind === "refuse");
    $("ask-yes").disabled = true; // for a moment: the second half of a double click must not answer
    clearTimeout(this.ready);
    this.ready = setTimeout(() => ($("ask-yes").disabled = false), DOUBLE_CLICK_MS);
    const words = kind === "confirm" && Boolean(prompt && prompt.wants_words);
    $("ask-why-label").hidden = (kind === "continue" || kind === "confirm") && !words;
    $("ask-why-label").firstChild.textContent = words ? "Your answer, typed or scanned " : "Why (may stay empty) ";
    $("ask-why").required = words;
    $("ask-who").value = localStorage.getItem("hil-who") || "";
    $("ask-why").value = "";
    $("ask-token").value = this.stream.token;
    $("ask-error").hidden = true;
    $("ask").showModal();
    ($("ask-who").value ? ($("ask-token").value ? $("ask-no") : $("ask-token")) : $("ask-who")).focus();
  }

  async send() {
    const who = $("ask-who").value.trim();
    const token = $("ask-token").value.trim();
    localStorage.setItem("hil-who", who);
    $("ask-yes").disabled = true;
    $("ask-error").hidden = true;
    const problem = await this.post({ ...this.request, who, why: $("ask-why").value.trim() }, token);
    $("ask-yes").disabled = false;
    $("ask-error").textContent = problem;
    $("ask-error").hidden = !problem;
    if (!problem) $("ask").close();
  }

  // Return what went wrong, or nothing.
  async post(body, token) {
    try {
      const response = await fetch("/api/ask", {
        method: "POST",
        headers: { authorization: `Bearer ${token}`, "content-type": "application/json" },
        body: JSON.stringify(body),
      });
      const answer = await response.json();
      if (response.status === 401) return "That token is not right. Nothing was asked.";
      if (!response.ok) return answer.error;
      this.stream.token = token;
      if (answer.accepted === false) return `The controller refused: ${answer.answer}`;
      this.say(answer.accepted ? `Accepted: ${answer.answer}` : "Asked. The controller has not answered yet.");
      return "";
    } catch {
      return "The server cannot be reached, so nothing was asked.";
    }
  }
}
