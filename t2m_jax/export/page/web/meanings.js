// What the training data lack, as t2m_jax/text/meanings.py finds it.

// Returns which of the missing sentences one with this meaning is nearest to; "" if it is nearer to those that were learned.
export function findMissing({ compared, sentences, learned, missing }, meaning) {
  const alike = (rows) => rows.map((row) => row.reduce((sum, value, place) => sum + value * meaning[place], 0));
  const best = (values) => [...values].sort((one, other) => other - one).slice(0, compared);
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const [toLearned, toMissing] = [alike(learned), alike(missing)];
  return mean(best(toMissing)) > mean(best(toLearned)) ? sentences[toMissing.indexOf(Math.max(...toMissing))] : "";
}
