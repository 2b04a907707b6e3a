// Made by web/scripts/make_weights.py; do not edit.

export const INPUTS = 12, HIDDEN = 24;

/** Floats of 32 bits, little-endian: mean, spread, first layer (row by row) and its bias, last layer and its bias. */
export const BYTES =
  "JIVhPn52bj4bLF0+pk/lv00xKzzGM049FeGRP29mwj+XRjY+0q4ePvQlED/1LXY+VI4xPousPT5bLcs90MCRP5DJcT+nyUQ/cUKA" +
  "PxVlyT+ULxdA4EKzP8/8Mz/zrvg+Bks+ve45YT4tFhm+ak9+vliRwb0QYis9qP6FvXnIOz7dI+Q8PyENPvZJp73q7pW9g3vDvozj" +
  "OL5gI5e9X4EFvTE+UT4hx24+H5ERvtCRIb7diyw+4KqGPraj772W5hA+Dq20vaiguD0a/qg+y4m0vm16T77v7Ra+Cncnvmh5XD5L" +
  "T4a+a3YkvucrX757e5G+7TUzvhgyMz5CAJk9xI8MPpKmqLwYHgm+ShOLPVgocr4HSIi++cpFvqFZJz5rygw+ieK1vThWpTpBlB4+" +
  "YvioPonKCz5+bpM9mk4uPpXROL5iI8g8G4GpvgbsQ75NTia+TeIoPUbZBD4TqOm9eHALPV01aj6uFvu7GuD1PGkqVT3kCWs+fhCT" +
  "Pr+Xlr7ArzC+qKvWPb+4Mj5dj1A+XrSCPgWiaTzUQHq+wTYmPTQ1Ir6V95m+5vByPvvnWj7LQp6+XjrqvCjVpTyNZJQ9v79RvgeT" +
  "PT7Z7Cq+0bqdPQB7zz1oDpU+NAQcPvhswb6tVJC+x/AAPhuEDz5KEwy+a9YSvshMsD6pNHo+vI8Rvs/0AL6pvzi+ljssPbdxWb4/" +
  "Po++9P8MPUVJzrtzZyK+WUYiPjlNTL7O/ZA+3pNyPsseN74neAa+uTl6vcDHkTtSABw9peqsPSIoh72Ahju+ibIMPm6gW76RYQq9" +
  "mGoLvVsv1b0xQT2+9kSUvurBtr0xvGI7M4CKvsF7hDVuDHc+uvenvRoCvj2cZYo8bHPOPSaYNj40PpY+M38jPtLRUz73Ebq99Kid" +
  "viWZTL7Gmzk+J0/DvJrfaL6S5Hi+0eB0voLIVb6vBV29PUpdPterFT4F9JK+MAFHPteUYb6Q0km9laIIvvypsbwGN766DS1zvm5A" +
  "WL5KvfA7KbOWPXBTFr7da5o92KObvqyBpzzUNpY+QU35vWh1ij4Vz7A9TamFvpjVCj5RIcu75jnwvaSZbD4l+He+e+eBPXyK8r1C" +
  "iSQ+ThKxPaFq4T2dB949TTJ4vU0z6DklsZe+g9+HPUnWUz7lUjw+z/iSvpKjZT0ZHuC983NovlU/ir37bRw+NREUvvmLBb35KNE9" +
  "j8tmPgtooL6cjZu+F2/TvfhQGz6CjR++ShmAPua5+T03XL89bP+9O9N0WzzGlBS9nSU9vr9Hib25hLY6bKivvgKSrb3El68+02aJ" +
  "vhakQz1NH6Q+kWQKPh3yiL1GphO+f+d/Pmksgb4fqDO+t4ssvq3RlLw5xzc9eoBWPtJpCD5JW6k+hABPPjGGSb5mH2M+Z0QxvkfF" +
  "LL7GF407Ha6XPa4BUz6n5wS+HaCiPP6GED73iJy+1fw2Pnu6hr7OFka9Hy3SvaJQD76rG+08FPNVPup6Fr4Uh0u+uC/7vRUoj75j" +
  "Yk0+V6GyvduiEr4MBR++ZDQ+PlziAD5oDSM+05RoPhaDwrz06Rq9EgMwPuISmD720yE+5X4+vv5m6L3DJI++OaczvQDaGL4c2o2+" +
  "mCtmPpJ1H74hXAU871gEPci4UT1YXjW+oBRMvjWNdT6jG8I9MpWJPpnVDb4vrio94cHlvLGpCj2FVjm+gEpTPYQ6CD4HeUc9rwjd" +
  "vfSMqb2o15U+bVV4vlN+qj1UaoG9gjROvgUW+Dxpqea93sIGPXuwED4BEG2+7UUEPiihPj6TSgE+5T+RvVjPKb7Z0EG9mmA+uhlI" +
  "rD33W1q7i0sFvD7JXDzo+q09noCDvMmfnz2LjBg9B3KyvUYJRL0KKwY901qfvbakSbsJVjA9pRthvNyIlT03W4u7iU64PVnATD3X" +
  "k2E9ZThMvYHCYLxN2ZK8p6M4PW9zkD1FL7A9UuxTu/U7sL3ZnZ88dI0NPFW50D1RP4+9Prq4vchzZ70Ddcc9aonRPAr8LDxr1Pa8" +
  "uHxCvdd01D07EZa9+Q5MPWiHtb2HLnA8mfhbvQZNlb24jho8qYxGPVRAM70=";
