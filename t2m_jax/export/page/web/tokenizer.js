// The tokens of sentences, of two kinds of tokenizers in the format of Hugging Face's `tokenizers`: WordPiece of BERT, and
// the byte-pair encoding that `t2m train` learns. Characters are handled one at a time, as that library does.

const CHINESE = /[\u4e00-\u9fff\u3400-\u4dbf\u{20000}-\u{2a6df}\u{2a700}-\u{2b73f}\u{2b740}-\u{2b81f}\u{2b920}-\u{2ceaf}\uf900-\ufaff\u{2f800}-\u{2fa1f}]/gu;
const PUNCTUATION = /([\p{P}\u0021-\u002f\u003a-\u0040\u005b-\u0060\u007b-\u007e])/gu;
const WORDS = /[\p{Alphabetic}\p{M}\p{Nd}\p{Pc}\p{Join_Control}]+|[^\p{Alphabetic}\p{M}\p{Nd}\p{Pc}\p{Join_Control}\p{White_Space}]+/gu;

const lowercase = (text) => [...text].map((character) => character.toLowerCase()).join(""); // Σ has no other form at the end

function bertWords(text) {
  const clean = text.replace(/(?![\t\n\r])[\p{C}\ufffd]/gu, "").replace(/\p{White_Space}/gu, " ").replace(CHINESE, " $& ");
  const plain = lowercase(clean.normalize("NFD").replace(/\p{Mn}/gu, ""));
  return plain.replace(PUNCTUATION, " $1 ").split(/\p{White_Space}+/u).filter(Boolean);
}

const bpeWords = (text) => lowercase(text.normalize("NFKC")).match(WORDS) ?? [];

// Returns the longest parts of a word that are in the vocabulary, or the unknown token for all of it.
function wordPieces(word, { vocabulary, unknown, prefix, longest }) {
  const characters = [...word];
  if (characters.length > longest) return [unknown];
  const tokens = [];
  for (let begin = 0; begin < characters.length; ) {
    let end = characters.length;
    const part = () => (begin ? prefix : "") + characters.slice(begin, end).join("");
    while (end > begin && !vocabulary.has(part())) end -= 1;
    if (end === begin) return [unknown];
    tokens.push(vocabulary.get(part()));
    begin = end;
  }
  return tokens;
}

// Returns the tokens of a word after its neighbors were joined in the order of the learned pairs.
function joinedPairs(word, { vocabulary, unknown, ranks }) {
  const parts = [...word];
  for (;;) {
    let [best, place] = [Infinity, -1];
    for (let at = 0; at + 1 < parts.length; at += 1) {
      const rank = ranks.get(`${parts[at]} ${parts[at + 1]}`) ?? Infinity;
      if (rank < best) [best, place] = [rank, at];
    }
    if (place < 0) return parts.map((part) => vocabulary.get(part) ?? unknown);
    parts.splice(place, 2, parts[place] + parts[place + 1]);
  }
}

function require(isKnown, part) {
  if (!isKnown) throw new Error(`tokenizer.json: its ${part} is unknown here`);
}

// Returns a map from tokens to their numbers.
function readVocabulary(table, largest) {
  require(table !== null && typeof table === "object" && !Array.isArray(table), "vocabulary");
  const entries = Object.entries(table);
  require(entries.every(([, number]) => Number.isInteger(number) && number >= 0 && number <= largest), "vocabulary");
  return new Map(entries);
}

export class Tokenizer {
  // `tree` is the content of tokenizer.json.
  constructor(tree) {
    const { model } = tree;
    const vocabulary = readVocabulary(model?.vocab, 1_000_000);
    const unknown = vocabulary.get(model.unk_token);
    require(unknown !== undefined, "unknown token");
    this.rules = { vocabulary, unknown };
    this.#readAdded(tree);
    if (model.type === "WordPiece") this.#readBert(tree);
    else this.#readPairs(tree);
  }

  #readAdded({ added_tokens: added }) {
    require(Array.isArray(added) && added.every(({ content, id }) => typeof content === "string" && content && Number.isInteger(id)), "list of added tokens");
    this.added = new Map(added.map(({ content, id }) => [content, id]));
    const escaped = [...this.added.keys()].map((content) => content.replace(/[\\^$.*+?()[\]{}|/]/g, "\\$&"));
    this.marks = escaped.length ? new RegExp(`(${escaped.join("|")})`, "u") : /(?!)/u;
  }

  #readBert({ normalizer, pre_tokenizer: splitter, post_processor: template, truncation, model }) {
    const { type, clean_text: clean, handle_chinese_chars: chinese, lowercase: lower, strip_accents: strip } = normalizer ?? {};
    require(type === "BertNormalizer" && clean && chinese && lower && strip !== false, "normalizer");
    require(splitter?.type === "BertPreTokenizer", "way to split");
    require(template?.type === "TemplateProcessing" && Array.isArray(template.single), "template");
    const tokens = template.single.map((part) => (part.Sequence ? null : this.added.get(part.SpecialToken?.id)));
    const place = tokens.indexOf(null);
    require(place >= 0 && tokens.every((token) => token !== undefined), "template");
    Object.assign(this, { before: tokens.slice(0, place), after: tokens.slice(place + 1), most: truncation?.max_length ?? Infinity });
    Object.assign(this.rules, { prefix: String(model.continuing_subword_prefix), longest: Number(model.max_input_chars_per_word) });
    Object.assign(this, { words: bertWords, pieces: wordPieces });
  }

  #readPairs({ normalizer, pre_tokenizer: splitter, post_processor: template, model }) {
    const steps = normalizer?.normalizers?.map(({ type }) => type).join();
    require(model.type === "BPE" && Array.isArray(model.merges), "model");
    require(steps === "NFKC,Lowercase" && splitter?.type === "Whitespace" && !template, "normalizer");
    this.rules.ranks = new Map(model.merges.map((pair, rank) => [Array.isArray(pair) ? pair.join(" ") : String(pair), rank]));
    Object.assign(this, { before: [], after: [], most: Infinity, words: bpeWords, pieces: joinedPairs });
  }

  // Returns the tokens of a sentence, with those that stand around it.
  encode(sentence) {
    const tokens = sentence.split(this.marks).flatMap((part) => {
      const added = this.added.get(part);
      return added === undefined ? this.words(part).flatMap((word) => this.pieces(word, this.rules)) : [added];
    });
    return [...this.before, ...tokens.slice(0, this.most - this.before.length - this.after.length), ...this.after];
  }
}
