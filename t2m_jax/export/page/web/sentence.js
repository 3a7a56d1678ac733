// What people type, as `t2m_jax/text/prompts.py` cleans and checks it.

const LONGEST = 1000; // characters
const INVISIBLE = /[\u00ad\u200b-\u200d\u2060\ufeff]/gu;
// Words of an order, a count or a length. Python cuts sentences there, counts and measures, with a dictionary and many samples.
const LEFT = new RegExp([
  "[-=]>|\\u2192|;|[.!](?= \\S)|, (?:and )?(?!\\w+(?:ing|ly)\\b)[a-z]+",
  "\\b(?:then|after|afterwards?|subsequently|thereafter|whereupon|before|prior to|upon|as soon as|when|having|followed by)\\b",
  "\\b(?:next(?! to)|finally|lastly|eventually|later|at last|in the end|at the end|until|till?|once|twice|thrice)\\b",
  "\\b(?:single|double|triple|couple|dozen|half|quarter|seconds?|secs?|minutes?|mins?)\\b|\\d+(?!\\d| degrees)",
  "\\b(?:(?<!with |on |by |in )one|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|\\w+teen|twenty|thirty|forty|fifty|sixty)\\b",
].join("|"), "giu");
const REFUSED = /[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Cn}\p{So}\p{Sk}]/u;

// Returns a sentence with straight quotes and single spaces; an error says why it cannot be used.
export function cleanSentence(typed) {
  const straight = typed.replace(/[\u02bc\u2018\u2019\u201a\u201b`\u00b4]/gu, "'").replace(/[\u201c\u201d\u201e\u201f]/gu, '"');
  const text = straight.replace(/\u00b0/gu, " degrees ").replace(INVISIBLE, "");
  if ([...text].length > LONGEST) throw new Error(`the sentence is too long; describe the motion in at most ${LONGEST} characters`);
  const folded = text.replace(/\p{White_Space}+/gu, " ").trim();
  const refused = REFUSED.exec(folded);
  if (refused) throw new Error(`the character ${refused[0]} cannot be read; leave it out and describe the motion in words`);
  if (!/[\p{L}\p{N}]/u.test(folded)) throw new Error("the sentence has no words; describe the motion, e.g. “a person walks forward”");
  return folded;
}

// Returns the words of a sentence whose order, counts and lengths the page leaves to the model.
export const leftToModel = (sentence) => [...new Set(sentence.match(LEFT))].map((text) => text.replace(/^, /, ""));
