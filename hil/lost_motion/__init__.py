"""Lost motion after a reversal (system C): strokes measured by the instrument, a rise of two smooth terms fitted,
proven, put into force.
"""
