// Makes a motion with the graphs of `t2m export onnx`, ONNX Runtime's C++ API and nlohmann/json.
//
//     sampler FOLDER "2 43 931 5582 3" SEED walk.bin
//
// The second argument has the tokens of a sentence, here "a person walks" with `demo`. Positions are written as float32, [frames, joints, 3].
#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <iterator>
#include <map>
#include <sstream>

#include <nlohmann/json.hpp>
#include <onnxruntime_cxx_api.h>

#include "sampler.hpp"

using nlohmann::json;

/// The graphs of a folder.
class OrtGraphs : public t2m::Graphs {
public:
  explicit OrtGraphs(const std::string &folder) {
    std::ifstream(folder + "/manifest.json") >> manifest_;
    for (const auto &[name, graph] : manifest_.at("graphs").get_ref<const json::object_t &>())
      sessions_.emplace(name, Ort::Session(environment_, (folder + "/" + graph.at("file").get<std::string>()).c_str(),
                                           Ort::SessionOptions{}));
  }

  const json &manifest() const { return manifest_; }

  /// Returns the text embedding of tokens, which are cut and filled up as the manifest says.
  std::vector<float> embed(std::vector<std::int32_t> tokens) {
    const json &text = manifest_.at("text"), &marks = text.at("marks");
    const std::size_t size = text.at("max_tokens");
    std::int32_t filling = 0;
    if (!marks.empty()) { // CLIP: a start, the sentence, and ends as far as there is room
      tokens.resize(std::min(tokens.size(), size - 2));
      tokens.insert(tokens.begin(), marks.at("start").get<std::int32_t>());
      filling = marks.at("end");
      tokens.resize(size, filling);
    }
    tokens.resize(std::min(tokens.size(), size));
    const auto count = static_cast<std::int32_t>(tokens.size());
    tokens.resize(size, filling);
    Values inputs;
    put<std::int32_t>(inputs, "text", "tokens", tokens);
    put<std::int32_t>(inputs, "text", "num_tokens", {count});
    return read<float>(run("text", std::move(inputs)).at("text_embedding"));
  }

  void begin(const std::vector<float> &text_embedding, float guidance_scale) override {
    Values inputs;
    put<float>(inputs, "begin", "text_embedding", text_embedding);
    if (manifest_["graphs"]["begin"]["inputs"].contains("guidance_scale"))
      put<float>(inputs, "begin", "guidance_scale", {guidance_scale});
    state_ = run("begin", std::move(inputs));
  }

  t2m::Row row(const std::vector<float> &noise, float temperature, bool may_stop) override {
    put<float>(state_, "row", "noise", noise);
    put<float>(state_, "row", "temperature", {temperature});
    put<std::int32_t>(state_, "row", "may_stop", {may_stop});
    Values found = run("row", std::move(state_));
    state_ = Values();
    const json &rules = manifest_.at("sampling");
    for (const std::string name : rules.at("state"))
      state_.emplace(name, std::move(found.at(rules.at("next").get<std::string>() + name)));
    return {read<std::int32_t>(found.at("codes")), read<float>(found.at("stop_score"))[0]};
  }

  std::vector<float> decode(const t2m::Codes &codes, std::int32_t num_rows) override {
    Values inputs;
    put<std::int32_t>(inputs, "decode", "codes", codes);
    put<std::int32_t>(inputs, "decode", "num_rows", {num_rows});
    return read<float>(run("decode", std::move(inputs)).at("positions"));
  }

  std::vector<float> clean(const std::vector<float> &positions, std::int32_t num_frames) override {
    if (!sessions_.count("lock")) // a folder of an older version
      return positions;
    Values inputs;
    put<float>(inputs, "calm", "positions", positions);
    put<std::int32_t>(inputs, "calm", "num_frames", {num_frames});
    Values calm = run("calm", std::move(inputs)); // `calm_positions`
    put<float>(calm, "lock", "positions", positions);
    put<std::int32_t>(calm, "lock", "num_frames", {num_frames});
    return read<float>(run("lock", std::move(calm)).at("clean_positions"));
  }

private:
  using Values = std::map<std::string, Ort::Value>;

  /// Adds an array in the shape that the manifest says.
  template <typename T>
  void put(Values &values, const std::string &graph, const std::string &name, const std::vector<T> &data) {
    const std::vector<std::int64_t> shape = manifest_["graphs"][graph]["inputs"][name]["shape"];
    Ort::Value value = Ort::Value::CreateTensor<T>(allocator_, shape.data(), shape.size());
    std::copy(data.begin(), data.end(), value.template GetTensorMutableData<T>());
    values.emplace(name, std::move(value));
  }

  template <typename T> static std::vector<T> read(const Ort::Value &value) {
    const T *data = value.GetTensorData<T>();
    return {data, data + value.GetTensorTypeAndShapeInfo().GetElementCount()};
  }

  /// Returns the outputs of a graph by name.
  Values run(const std::string &name, Values inputs) {
    const json &graph = manifest_.at("graphs").at(name);
    std::vector<const char *> given, wanted;
    std::vector<Ort::Value> values;
    for (const auto &entry : graph.at("inputs").get_ref<const json::object_t &>()) {
      given.push_back(entry.first.c_str());
      values.push_back(std::move(inputs.at(entry.first)));
    }
    for (const auto &entry : graph.at("outputs").get_ref<const json::object_t &>())
      wanted.push_back(entry.first.c_str());
    auto results = sessions_.at(name).Run(Ort::RunOptions{nullptr}, given.data(), values.data(), values.size(),
                                          wanted.data(), wanted.size());
    Values found;
    for (std::size_t i = 0; i < wanted.size(); ++i)
      found.emplace(wanted[i], std::move(results[i]));
    return found;
  }

  Ort::Env environment_;
  Ort::AllocatorWithDefaultOptions allocator_;
  json manifest_;
  std::map<std::string, Ort::Session> sessions_;
  Values state_;
};

t2m::Rules rules_of(const json &manifest) {
  const json &sampling = manifest.at("sampling"), &stop = sampling.at("stop"), &motion = manifest.at("motion");
  const json &noise = manifest.at("graphs").at("row").at("inputs").at("noise").at("shape");
  return {sampling.at("max_rows"), sampling.at("min_rows"),  noise.at(1),
          noise.at(2),             stop.at("rule"),          stop.at("threshold"),
          stop.at("keeps_last"),   motion.at("frames_per_row"), motion.at("context_rows")};
}

int main(int count, char **arguments) {
  if (count != 5) {
    std::cerr << "usage: sampler FOLDER TOKENS SEED OUTPUT\n";
    return 2;
  }
  OrtGraphs graphs(arguments[1]);
  std::istringstream tokens(arguments[2]);
  const json &scale = graphs.manifest().at("sampling").at("guidance_scale");
  t2m::Sampler sampler(graphs, rules_of(graphs.manifest()), std::strtoull(arguments[3], nullptr, 10));
  sampler.begin(graphs.embed({std::istream_iterator<std::int32_t>(tokens), {}}),
                scale.is_null() ? 1.0f : scale.get<float>());
  while (sampler.step()) {
  }
  for (const std::int32_t code : sampler.codes())
    std::cout << code << ' ';
  std::cout << '\n';
  const std::vector<float> positions = sampler.clean();
  const auto size = static_cast<std::streamsize>(positions.size() * sizeof(float));
  std::ofstream(arguments[4], std::ios::binary).write(reinterpret_cast<const char *>(positions.data()), size);
  return 0;
}
