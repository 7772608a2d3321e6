/* One kind of group: an axis, or several that a bound or the model couples. The generator writes
   before it KIND and the sizes NX states, NU inputs, NM measured, NY outputs, NR rows, and SOFT (any
   row is soft); after it the structures `constants` and `maps`. */

#define NAME(x) JOIN(x, KIND)
#define NF (HORIZON * NY)
#define NZ (MOVES * NU)
#define NP (NX + NU)
#define XB BLOCKS(NX)
#define HB BLOCKS(NM + NY)
#define FB BLOCKS(NF)
#define ZB BLOCKS(NZ)
#define RB BLOCKS(NR)
#define GB (HB + FB + RB)
