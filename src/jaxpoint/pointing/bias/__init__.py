"""How far people's lines of pointing miss what they mean, learnt from known targets and taken back (thesis 7.4).

`fit.fit_bias` learns a `bias.Bias` from `pointings.Pointings`, `drawn.drawn` draws lines turned by it, and its `spread`
says how far corrected lines still lie from what is meant.
"""
