// The same as fake_graphs.cpp with the loop of docs/engines/Sampler.cs.
using System;
using System.Linq;
using T2m;

class FakeGraphs : IGraphs
{
    const int Quantizers = 2, Classes = 5;
    float[] scores, given = new float[0];
    int made;

    public void Begin(float[] textEmbedding, float guidanceScale) { }

    public Row Row(float[] noise, float temperature, bool mayStop)
    {
        var codes = new int[Quantizers];
        for (int i = 0; i < Quantizers; i++)
        {
            var own = noise.Skip(i * Classes).Take(Classes).ToArray();
            codes[i] = Array.IndexOf(own, own.Max());
        }
        return new Row { Codes = codes, StopScore = scores[made++] };
    }

    public float[] Decode(int[] codes, int numRows) => Enumerable.Repeat(1f, codes.Length / Quantizers * 4 * 3).ToArray();

    public float[] Clean(float[] positions, int numFrames)
    {
        given = positions;
        return positions.Select(value => value + numFrames).ToArray();
    }

    public static void Main(string[] arguments)
    {
        var culture = System.Globalization.CultureInfo.InvariantCulture;
        var graphs = new FakeGraphs { scores = arguments.Skip(3).Select(text => float.Parse(text, culture)).ToArray() };
        var stop = new Manifest.Stop { rule = arguments[0], threshold = 0.5, keeps_last = arguments[1] == "1" };
        var noise = new Manifest.Array { shape = new[] { 1, Quantizers, Classes } };
        var manifest = new Manifest
        {
            sampling = new Manifest.Sampling { max_rows = graphs.scores.Length, min_rows = int.Parse(arguments[2]), stop = stop },
            motion = new Manifest.Motion { frames_per_row = 4, context_rows = 2 },
            graphs = new Manifest.Graphs { row = new Manifest.Graph { inputs = new Manifest.Inputs { noise = noise } } },
        };
        var sampler = new Sampler(graphs, manifest, 7);
        sampler.Begin(new float[0], 1);
        for (bool more = true; more;)
        {
            more = sampler.Step();
            Console.Write(sampler.NumFinalFrames + " ");
        }
        Console.WriteLine("\n" + string.Join(" ", sampler.Codes));
        float[] decoded = sampler.Decode(), cleaned = sampler.Clean();
        foreach (var values in new[] { decoded, graphs.given, cleaned })
            Console.Write(values.Length + " " + values.Sum().ToString(culture) + " ");
    }
}
