# SPDX-License-Identifier: GPL-3.0-or-later
"""What the worlds `space` and `factory` are made of: waveforms between samples, a radio chain, causes, truths.

files.py    a case's files: twin.yaml and SigMF
waves.py    periodic and single waveforms, evaluated at any instant
chain.py    a link from the modulator to the converter, cause by cause
causes.py   the families of the contract, each in several forms
foreign.py  physics that no family of the contract describes
world.py    scenes: which waveform, paths, levels and file
draw.py     strengths, files and truths of one case
"""
