"""Everyday activities that motion capture seldom has: what a sentence with an unknown word may be about."""

_ACTIVITIES = """
    swims, rides a bicycle, drives a car, rides a horse, rows a boat, skis down a slope, skates on ice, surfs a
    wave, rides a skateboard, swings a golf club, hits a tennis ball, swings a baseball bat, dribbles a basketball,
    shoots an arrow, lifts a heavy barbell, does push-ups, does sit-ups, does a handstand, does pull-ups on a bar,
    spins a hula hoop, plays the piano, plays the guitar, plays the drums, plays the violin, blows a trumpet,
    conducts an orchestra, sings into a microphone, whistles a tune, snaps their fingers, eats soup with a spoon,
    chops vegetables, stirs a pot, kneads dough, flips a pancake, peels a potato, bites an apple, licks an ice cream
    cone, brushes their teeth, combs their hair, shaves their face, takes a shower, puts on lipstick, trims their
    fingernails, blows their nose, puts on a jacket, ties their shoelaces, takes off a hat, buttons a shirt, irons
    clothes, hangs laundry on a line, makes the bed, hammers a nail, saws a wooden board, drills a hole, tightens a
    bolt, lays bricks, paints a picture, knits a scarf, shapes a clay pot, cuts paper with scissors, wraps a gift,
    digs with a shovel, waters the plants, mows the lawn, milks a cow, pets a cat, catches a fish, types on a
    keyboard, writes a letter, reads a book, talks on the phone, takes a photograph, plays a video game, plays
    chess, shuffles a deck of cards, flies a kite, plays with a yo-yo, plays pool with a cue, sneezes, yawns, cries,
    vomits, shivers from the cold, scratches their back, bandages a wound, performs chest compressions, hugs a
    friend, shakes hands with someone, nods their head, flexes their biceps, prays, rocks a baby to sleep, casts a
    magic spell, flies like a superhero, fires a pistol, unlocks a door, pushes a shopping cart, pulls a rope, opens
    an umbrella, smokes a cigarette
"""
ACTIVITIES = tuple(f"a person {activity}" for activity in " ".join(_ACTIVITIES.split()).split(", "))
"""Plain sentences."""
