// The sampling loop of sampler.py in C#, with the standard library alone: for ONNX Runtime (OrtSampler.cs), Unity's
// Inference Engine and others, which implement IGraphs. docs/engines.md explains each step.
using System;
using System.Collections.Generic;

namespace T2m
{
    /// <summary>The fields of manifest.json that are needed; Newtonsoft.Json and others read it.</summary>
    public class Manifest
    {
        public Sampling sampling;
        public Motion motion;
        public Graphs graphs;
        public Text text;

        public class Sampling
        {
            public int max_rows;
            public int min_rows;
            public string[] state;
            public string next;
            public float? guidance_scale; // null without guidance
            public Stop stop;
        }

        public class Stop
        {
            public string rule;
            public double threshold;
            public bool keeps_last;
        }

        public class Motion
        {
            public float fps;
            public int frames_per_row;
            public int context_rows;
            public string[] joints;
            public int[] parents;
        }

        public class Graphs
        {
            public Graph row;
        }

        public class Graph
        {
            public Inputs inputs;
        }

        public class Inputs
        {
            public Array noise;
        }

        public class Array
        {
            public int[] shape;
        }

        public class Text
        {
            public int max_tokens;
            public Marks marks;
        }

        /// <summary>Tokens of CLIP; zeros with other encoders.</summary>
        public class Marks
        {
            public int start;
            public int end;
        }
    }

    public struct Row
    {
        public int[] Codes;
        public float StopScore;
    }

    /// <summary>The graphs of a model. The state stays in here: a game needs not look at it.</summary>
    public interface IGraphs
    {
        /// <summary>Runs `begin`, and keeps the state that it gives.</summary>
        void Begin(float[] textEmbedding, float guidanceScale);

        /// <summary>Runs `row`, and keeps the next state.</summary>
        Row Row(float[] noise, float temperature, bool mayStop);

        /// <summary>Runs `decode` with max_rows rows of codes; returns positions in meters, [frames, joints, 3].</summary>
        float[] Decode(int[] codes, int numRows);

        /// <summary>Runs `calm` and `lock`; `positions` has zeros after numFrames frames. Without these graphs, returns them
        /// as they are.</summary>
        float[] Clean(float[] positions, int numFrames);
    }

    /// <summary>Makes one motion, a row at each step, so that a game can do one step in each frame.</summary>
    public sealed class Sampler
    {
        readonly IGraphs graphs;
        readonly Manifest manifest;
        readonly ulong seed;
        readonly float temperature;
        readonly List<int> codes = new List<int>();
        int made;
        int bestRows = 1;
        float bestScore = float.NegativeInfinity;
        bool ended;

        public Sampler(IGraphs graphs, Manifest manifest, ulong seed, float temperature = 1)
        {
            this.graphs = graphs;
            this.manifest = manifest;
            this.seed = seed;
            this.temperature = temperature;
        }

        /// <summary>Codes so far, [rows, codes of a row].</summary>
        public IReadOnlyList<int> Codes => codes;

        /// <summary>How many frames of Decode are valid.</summary>
        public int NumFrames => NumRows * manifest.motion.frames_per_row;

        /// <summary>How many frames no later row changes.</summary>
        public int NumFinalFrames
        {
            get
            {
                if (ended)
                    return NumFrames;
                if (manifest.sampling.stop.rule == "argmax")
                    return 0;
                return Math.Max(0, NumRows - manifest.motion.context_rows) * manifest.motion.frames_per_row;
            }
        }

        int Width => manifest.graphs.row.inputs.noise.shape[1];
        int NumRows => codes.Count / Width;
        int MaxFrames => manifest.sampling.max_rows * manifest.motion.frames_per_row;

        public void Begin(float[] textEmbedding, float guidanceScale) => graphs.Begin(textEmbedding, guidanceScale);

        /// <summary>Makes a row; returns false if the motion has ended.</summary>
        public bool Step()
        {
            if (ended)
                return false;
            var rules = manifest.sampling;
            var noise = new float[Width * manifest.graphs.row.inputs.noise.shape[2]];
            ulong first = (ulong)made * ((ulong)noise.Length + 1);
            for (int i = 0; i < noise.Length; i++)
                noise[i] = (float)-Math.Log(-Math.Log(Uniform(seed, first + (ulong)i)));
            bool mayStop = made + (rules.stop.keeps_last ? 1 : 0) >= rules.min_rows;
            Row row = graphs.Row(noise, temperature, mayStop);
            made++;
            double last = Uniform(seed, first + (ulong)noise.Length);
            bool stops = mayStop && Stops(row.StopScore, Math.Log(last / (1 - last)));
            if (!stops || rules.stop.keeps_last)
                codes.AddRange(row.Codes);
            if (mayStop && row.StopScore > bestScore)
            {
                bestScore = row.StopScore;
                bestRows = made;
            }
            ended = stops || made == rules.max_rows;
            if (ended && rules.stop.rule == "argmax")
                codes.RemoveRange(bestRows * Width, codes.Count - bestRows * Width);
            return !ended;
        }

        /// <summary>Returns positions of the rows so far in meters, [NumFrames, joints, 3].</summary>
        public float[] Decode()
        {
            var padded = new int[manifest.sampling.max_rows * Width];
            codes.CopyTo(padded);
            var positions = graphs.Decode(padded, NumRows);
            System.Array.Resize(ref positions, positions.Length / MaxFrames * NumFrames);
            return positions;
        }

        /// <summary>Returns positions of a motion that has ended with less trembling, rigid bones and feet that stand
        /// still.</summary>
        public float[] Clean()
        {
            var positions = Decode();
            int size = positions.Length;
            if (size == 0)
                return positions;
            System.Array.Resize(ref positions, size / NumFrames * MaxFrames);
            positions = graphs.Clean(positions, NumFrames);
            System.Array.Resize(ref positions, size);
            return positions;
        }

        bool Stops(double score, double logistic)
        {
            switch (manifest.sampling.stop.rule)
            {
                case "end":
                    return score > 0.5;
                case "threshold":
                    return 1 / (1 + Math.Exp(-score)) >= manifest.sampling.stop.threshold;
                case "sampled":
                    return score + logistic > 0;
                default:
                    return false; // argmax: cut at the end
            }
        }

        /// <summary>Returns a number of a seed, above 0 and below 1: SplitMix64, the same in every language.</summary>
        public static double Uniform(ulong seed, ulong index)
        {
            unchecked
            {
                ulong bits = seed + 0x9E3779B97F4A7C15UL * (index + 1);
                bits = (bits ^ (bits >> 30)) * 0xBF58476D1CE4E5B9UL;
                bits = (bits ^ (bits >> 27)) * 0x94D049BB133111EBUL;
                return (((bits ^ (bits >> 31)) >> 12) + 0.5) / 4503599627370496.0; // 2^52
            }
        }

        /// <summary>Changes positions [frames, joints, 3] to Unity's axes: X to the right, Y up, Z ahead.</summary>
        public static void ToUnity(float[] positions)
        {
            for (int i = 0; i < positions.Length; i += 3)
                positions[i] = -positions[i];
        }
    }
}
