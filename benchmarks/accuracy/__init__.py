"""Accuracy: Monte Carlo over scenarios and methods, beside the truth and beside what is promised.

Run r has the seed r = 0, 1, 2 ..; no method is tuned to a scenario beyond what its name says.  The scenarios:

* A. The scenario does not specify the input. Here it is one period of a PRBS of 8 bits held 8 samples (0.4 s, about
  the geometric mean of the plant's two time constants), or a random binary input with the same hold, different in each
  run; a hold of one sample is "beside". The buffered methods have a step size of 0.001 and Lambda(s) = (s + 2)^2
  where it is named, else the filter chosen from the data.
* B. The scenario's own bounds hold for the first 100 runs, the coverage is of 200.
* C. The random binary input is held 10 samples (0.1 s), about the plant's time constant 1/omega = 0.08 s; holds of
  5 and 20 samples are "beside". The process noise follows from prior knowledge: a quarter of a parameter's range,
  squared, over the time in which the parameter moves through it (0.1, 4.05 and 0 per second); ten times and a tenth of
  it are shown as well. Errors count from the first estimate on (after 5 s). "inside" is how often, at 20 instants, the
  true value lies in the nominal 95 % interval.
* D. Voltage and noise differ in each run; every method is given the working point and the squared input.
* F. Two interpretations: the input switches at recorded instants only ("recorded"), or also at the instants whose
  samples are lost, which no estimator can know ("unseen"). With a hold of one sample a tenth of the input is then lost.
* G. Nominal 95 % intervals of every parameter and of natural frequency f and damping zeta of the poles, slowest
  first. A real pole's damping is always 1 and left out; for A's two real poles f and zeta are those of
  s^2 + a1 s + a0. With 200 runs the measured coverage itself has a standard deviation of 1.5 %. A tracking filter
  (RLS with a memory, Kalman) allows for parameters that move; for constant parameters its intervals are too wide.
* H. The input of the second case rests after a tenth of the record, before there is a trusted model; one that was
  trusted stays so. The wrong dead time is at least half the slowest time constant: a shorter one may pass. A wrong dt
  is found by the time stamps of these records; without stamps nobody could tell.
* I. `Identifier(Structure(poles), dt, startup=len // 10)`; references are independent output-error fits.
* J. First-order coloured noise. The default solves the record again up to 10000 samples; for longer records, and
  with a memory, it is a pure recursion. The Cramer-Rao bound knows the colour, and does not know the offset.
* K. u and y of a loop, sampled before u is set. The error of a coefficient is in percent of its own size, of a_i at
  least of that which all poles, as fast as they are, would give it. Bias and its standard error are those of the
  coefficient with the largest bias, the RMS error is that of the coefficient with the largest. An estimate is wrong if
  a coefficient is 10 % off, and has diverged if one is 100 % off or there is none. The anchor compares y with
  what r makes of the whole loop, its controller known, whitened by an autoregression of order 8, begun at the truth; it
  takes about a tenth of a second of processor time a run. Without r only the plants that are stable or integrate have
  a promise on their errors. The published loop is that of Gilson, Garnier, Young and Van den Hof (2008), its errors are
  in percent of the coefficients; the controller in continuous time answers between the samples, which none of the
  methods describes.
"""
