// Runs the loop of docs/engines/sampler.hpp with given stop scores; a row's codes are where its noise is largest.
//
//     fake_graphs RULE KEEPS_LAST MIN_ROWS SCORE...
//
// There are as many rows as scores. Prints how many frames were final after each row, on a second line the codes, and on a
// third one counts and sums of the numbers that were decoded, given to the clean-up, and cleaned.
#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <numeric>

#include "sampler.hpp"

constexpr std::size_t kQuantizers = 2, kClasses = 5;

struct FakeGraphs : t2m::Graphs {
  std::vector<float> scores, given;
  std::size_t made = 0;

  void begin(const std::vector<float> &, float) override {}
  t2m::Row row(const std::vector<float> &noise, float, bool) override {
    t2m::Codes codes;
    for (auto first = noise.begin(); first != noise.end(); first += kClasses)
      codes.push_back(static_cast<std::int32_t>(std::max_element(first, first + kClasses) - first));
    return {codes, scores.at(made++)};
  }
  std::vector<float> decode(const t2m::Codes &codes, std::int32_t) override {
    return std::vector<float>(codes.size() / kQuantizers * 4 * 3, 1.0f);
  }
  std::vector<float> clean(const std::vector<float> &positions, std::int32_t num_frames) override {
    given = positions;
    std::vector<float> cleaned = positions;
    for (float &value : cleaned)
      value += static_cast<float>(num_frames);
    return cleaned;
  }
};

int main(int count, char **arguments) {
  FakeGraphs graphs;
  for (int i = 4; i < count; ++i)
    graphs.scores.push_back(std::strtof(arguments[i], nullptr));
  const auto min_rows = static_cast<std::size_t>(std::atoi(arguments[3]));
  const t2m::Rules rules{graphs.scores.size(), min_rows, kQuantizers, kClasses, arguments[1], 0.5,
                         std::atoi(arguments[2]) != 0, 4, 2};
  t2m::Sampler sampler(graphs, rules, 7);
  sampler.begin({}, 1.0f);
  for (bool more = true; more; std::cout << sampler.num_final_frames() << ' ')
    more = sampler.step();
  std::cout << '\n';
  for (const std::int32_t code : sampler.codes())
    std::cout << code << ' ';
  std::cout << '\n';
  std::vector<float> decoded = sampler.decode(), cleaned = sampler.clean();
  for (const auto *values : {&decoded, &graphs.given, &cleaned})
    std::cout << values->size() << ' ' << std::accumulate(values->begin(), values->end(), 0.0f) << ' ';
}
