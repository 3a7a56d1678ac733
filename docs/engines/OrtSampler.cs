// Makes a motion with the graphs of `t2m export onnx` and Microsoft.ML.OnnxRuntime.
//
//     OrtSampler FOLDER "2 43 931 5582 3" SEED walk.bin
//
// The second argument has the tokens of a sentence, here "a person walks" with `demo`. Positions are written as float32, [frames, joints, 3].
using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Runtime.Serialization.Json;
using Microsoft.ML.OnnxRuntime;

namespace T2m
{
    /// <summary>The graphs of a folder.</summary>
    public sealed class OrtGraphs : IGraphs, IDisposable
    {
        readonly Dictionary<string, InferenceSession> sessions;
        readonly Manifest manifest;
        Dictionary<string, OrtValue> state = new Dictionary<string, OrtValue>();

        public OrtGraphs(string folder, Manifest manifest)
        {
            this.manifest = manifest;
            sessions = Directory.GetFiles(folder, "*.onnx").ToDictionary(
                Path.GetFileNameWithoutExtension, path => new InferenceSession(path));
        }

        /// <summary>Returns the text embedding of tokens, which are cut and filled up as the manifest says.</summary>
        public float[] Embed(IEnumerable<int> tokens)
        {
            int size = manifest.text.max_tokens, end = manifest.text.marks.end;
            if (end > 0) // CLIP: a start, the sentence, and ends as far as there is room
                tokens = tokens.Take(size - 2).Prepend(manifest.text.marks.start).Concat(Enumerable.Repeat(end, size));
            var kept = tokens.Take(size).ToArray();
            var inputs = new Dictionary<string, Array> { { "num_tokens", new[] { kept.Length } } };
            Array.Resize(ref kept, size);
            inputs["tokens"] = kept;
            return Run("text", inputs)["text_embedding"].GetTensorDataAsSpan<float>().ToArray();
        }

        public void Begin(float[] textEmbedding, float guidanceScale)
        {
            var inputs = new Dictionary<string, Array> { { "text_embedding", textEmbedding } };
            if (sessions["begin"].InputMetadata.ContainsKey("guidance_scale"))
                inputs["guidance_scale"] = new[] { guidanceScale };
            Keep(Run("begin", inputs), "");
        }

        public Row Row(float[] noise, float temperature, bool mayStop)
        {
            var found = Run("row", new Dictionary<string, Array>
            {
                { "noise", noise }, { "temperature", new[] { temperature } }, { "may_stop", new[] { mayStop ? 1 : 0 } },
            });
            Keep(found, manifest.sampling.next);
            var codes = found["codes"].GetTensorDataAsSpan<int>().ToArray();
            return new Row { Codes = codes, StopScore = found["stop_score"].GetTensorDataAsSpan<float>()[0] };
        }

        public float[] Decode(int[] codes, int numRows)
        {
            var inputs = new Dictionary<string, Array> { { "codes", codes }, { "num_rows", new[] { numRows } } };
            return Run("decode", inputs)["positions"].GetTensorDataAsSpan<float>().ToArray();
        }

        public float[] Clean(float[] positions, int numFrames)
        {
            if (!sessions.ContainsKey("lock")) // a folder of an older version
                return positions;
            var inputs = new Dictionary<string, Array> { { "positions", positions }, { "num_frames", new[] { numFrames } } };
            inputs["calm_positions"] = Run("calm", inputs)["calm_positions"].GetTensorDataAsSpan<float>().ToArray();
            return Run("lock", inputs)["clean_positions"].GetTensorDataAsSpan<float>().ToArray();
        }

        public void Dispose()
        {
            foreach (var session in sessions.Values)
                session.Dispose();
        }

        /// <summary>Makes outputs of a graph the state of the next row.</summary>
        void Keep(Dictionary<string, OrtValue> found, string prefix)
        {
            foreach (var value in state.Values)
                value.Dispose();
            state = manifest.sampling.state.ToDictionary(name => name, name => found[prefix + name]);
        }

        /// <summary>Returns the outputs of a graph by name; inputs that are not given are in the state.</summary>
        Dictionary<string, OrtValue> Run(string name, Dictionary<string, Array> inputs)
        {
            var session = sessions[name];
            var made = inputs.ToDictionary(entry => entry.Key, entry => Value(session, entry.Key, entry.Value));
            var given = session.InputMetadata.Keys.ToList();
            var values = given.Select(key => made.ContainsKey(key) ? made[key] : state[key]).ToList();
            using (var options = new RunOptions())
            {
                var outputs = session.OutputMetadata.Keys.ToList();
                var results = session.Run(options, given, values, outputs);
                foreach (var value in made.Values)
                    value.Dispose();
                return outputs.Zip(results, (key, value) => new { key, value })
                    .ToDictionary(one => one.key, one => one.value);
            }
        }

        static OrtValue Value(InferenceSession session, string name, Array data)
        {
            var shape = session.InputMetadata[name].Dimensions.Select(size => (long)size).ToArray();
            var floats = data as float[];
            return floats != null
                ? OrtValue.CreateTensorValueFromMemory(floats, shape)
                : OrtValue.CreateTensorValueFromMemory((int[])data, shape);
        }
    }

    public static class Program
    {
        public static int Main(string[] arguments)
        {
            if (arguments.Length != 4)
            {
                Console.Error.WriteLine("usage: OrtSampler FOLDER TOKENS SEED OUTPUT");
                return 2;
            }
            Manifest manifest;
            using (var file = File.OpenRead(Path.Combine(arguments[0], "manifest.json")))
                manifest = (Manifest)new DataContractJsonSerializer(typeof(Manifest)).ReadObject(file);
            using (var graphs = new OrtGraphs(arguments[0], manifest))
            {
                var tokens = arguments[1].Split(' ').Select(int.Parse);
                var sampler = new Sampler(graphs, manifest, ulong.Parse(arguments[2]));
                sampler.Begin(graphs.Embed(tokens), manifest.sampling.guidance_scale ?? 1);
                while (sampler.Step()) { }
                Console.WriteLine(string.Join(" ", sampler.Codes));
                var positions = sampler.Clean();
                var bytes = new byte[positions.Length * sizeof(float)];
                Buffer.BlockCopy(positions, 0, bytes, 0, bytes.Length);
                File.WriteAllBytes(arguments[3], bytes);
            }
            return 0;
        }
    }
}
